# SPDX-License-Identifier: Apache-2.0
"""Moving drawings of plant and estimates: positions, shapes, films."""

# SPDX-License-Identifier: Apache-2.0
"""All events of a recording at once: the motion and the parameters that explain them best."""

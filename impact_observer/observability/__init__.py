# SPDX-License-Identifier: Apache-2.0
"""Whether the impacts of a recording determine the state: rank, condition, directions."""

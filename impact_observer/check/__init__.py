# SPDX-License-Identifier: Apache-2.0
"""Whether an observer can use a bag, and what is wrong with it."""

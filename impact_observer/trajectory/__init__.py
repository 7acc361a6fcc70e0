# SPDX-License-Identifier: Apache-2.0
"""One linearisation of a motion with its impacts; see docs/theory/filter.md."""

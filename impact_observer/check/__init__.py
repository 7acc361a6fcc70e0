# SPDX-License-Identifier: Apache-2.0
"""Checks of bags and models: faults, and their remedies."""

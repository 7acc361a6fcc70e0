# SPDX-License-Identifier: Apache-2.0
"""The flow of one linear phase: states at given instants, exact but for rounding."""

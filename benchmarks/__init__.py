# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: the package and its peers, measured side by side."""

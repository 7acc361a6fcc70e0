# SPDX-License-Identifier: Apache-2.0
"""Estimates against the truth: what differs, by how much, in tables and pictures."""

# SPDX-License-Identifier: Apache-2.0
"""The files of a new rig: its model, its sensors and its launch file."""

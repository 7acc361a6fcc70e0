# SPDX-License-Identifier: Apache-2.0
"""What closed contacts do: impact law, position projection, clutches, persistent contact."""

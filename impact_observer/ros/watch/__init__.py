# SPDX-License-Identifier: Apache-2.0
"""The live view of a running plant and its observers: what `watch` receives, keeps and shows."""

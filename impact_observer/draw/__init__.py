# SPDX-License-Identifier: Apache-2.0
"""Pictures, films, robot models, and layouts for plotting tools."""

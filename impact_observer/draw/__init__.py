# SPDX-License-Identifier: Apache-2.0
"""Pictures, films and layouts: what is drawn, and where."""

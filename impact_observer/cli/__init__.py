# SPDX-License-Identifier: Apache-2.0
"""The command ``impact-observer``: one module a subcommand, each a thin layer over a function."""

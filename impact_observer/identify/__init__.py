# SPDX-License-Identifier: Apache-2.0
"""Identifying a model from impact times: parameters, exact sensitivities, maximum likelihood."""

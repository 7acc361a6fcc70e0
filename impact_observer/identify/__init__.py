"""Identifying a model from impact times: parameters, exact sensitivities, maximum likelihood."""

# SPDX-License-Identifier: Apache-2.0
"""Robots: rigid bodies of a URDF with contacts against planes. Needs the extra ``robots``."""

# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of impact times on arrays of hypotheses."""

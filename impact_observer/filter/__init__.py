# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of impact times, and the hypotheses on which events were true."""

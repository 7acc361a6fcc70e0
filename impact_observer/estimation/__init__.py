"""The Kalman filter of impact times, and the hypotheses on which events were true.

A state has a square-root covariance. An impact is a pseudo-measurement of its gap and a saltation
of the state; a bank weighs hypotheses of what each event was.
"""

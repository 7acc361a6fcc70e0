# SPDX-License-Identifier: Apache-2.0
"""The warnings of a model that does not explain the impacts."""

MISFIT = (
    "the model does not explain the impacts: restitution, stiffness, damping, forces or gaps are"
    " not the plant's, or the stamps are late or drift; see docs/troubles.md"
)
CONTRADICTION = (
    "an impact came {:.3g} standard deviations or more from its prediction, which the declared"
    " errors of sensor and model exclude: declare larger ones, or leave clock_error, missed,"
    " spurious, mislabelled and model_error at their defaults; see docs/troubles.md"
)
SILENCE = (
    "not reported: the sensor or its line may be dead, or the"
    " plant has stopped; see docs/troubles.md"
)
JUMPS = (
    "the velocities after hits do not follow from the impact law: the tip rubs, or covers or"
    " joints are soft; encoders alone tell these velocities; see docs/robots.md"
)
EXPLAINED = "the model explains the impacts again"
"""What is said when a misfit has ended."""

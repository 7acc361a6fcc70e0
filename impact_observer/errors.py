# SPDX-License-Identifier: Apache-2.0
"""The package's errors: one line with the thing, the value found and the value expected.

The rule of exit codes: 2 is wrong use, an argument or a file that is not what the command takes,
such as one of another kind, or a bag without the topic or the model that is needed; 1 is a failed
job, such as data that are damaged, too few, or do not fit the model, or a disk that is full.

Every error a user can cause derives from :class:`ImpactObserverError`; its ``exit_code`` is
what a command ends with. Anything else that escapes is a bug; ``process_end`` reports it.
"""

from collections.abc import Iterable
from typing import ClassVar


class ImpactObserverError(Exception):
    """Root of all errors that are reported as one line.

    Attributes:
        exit_code: 1 for a job that failed, 2 for wrong use.
    """

    exit_code: ClassVar[int] = 1


class UsageError(ImpactObserverError, ValueError):
    """An argument, option or parameter that cannot be used."""

    exit_code = 2


class OutputError(ImpactObserverError):
    """A file that cannot be written, such as on a disk that is full."""


class UnsetError(UsageError):
    """A required option is not set.

    Attributes:
        option: name of the option.
    """

    def __init__(self, option: str, message: str) -> None:
        """Say in ``message`` what is expected."""
        super().__init__(message)
        self.option = option


class ModelError(UsageError):
    """A model that is not a valid impacting system.

    Attributes:
        key: the key of the model file that is at fault, such as ``contacts[0].restitution``.
    """

    def __init__(self, key: str, problem: str) -> None:
        """Name the ``key`` at fault and the ``problem``: found, expected, remedy."""
        line = f"{key}: {problem}" if key else problem
        super().__init__(" ".join(line.splitlines()))  # names in a file may hold line ends
        self.key = key
        self.problem = problem

    def in_file(self, source: str) -> "ModelError":
        """The error with the name of the file before the key, unless it is there."""
        if self.key == source or self.key.startswith(f"{source}: "):
            return self
        return ModelError(f"{source}: {self.key}" if self.key else source, self.problem)


class NotLinearError(UsageError):
    """A model of a robot where a linear model is needed."""

    def __init__(self, model: str, what: str = "") -> None:
        """Name the ``model``, such as ``arm: a robot (urdf: arm.urdf)``, and the job."""
        super().__init__(f"{model}; {what or 'this'} needs a linear model")
        self._model = model

    def in_command(self, command: str) -> "NotLinearError":
        """The error with the name of the ``command`` that needs a linear model."""
        return NotLinearError(self._model, command)


class BagError(ImpactObserverError):
    """A bag that cannot be read, written or used for the job."""


class UnfitBagError(BagError, UsageError):
    """A file that is no bag, or a bag without what the command takes: wrong use."""


class IdentificationError(ImpactObserverError):
    """Parameters that the recorded impacts do not determine."""


class SweepError(ImpactObserverError):
    """A sweep that cannot go on."""


class DynamicsError(ImpactObserverError, ArithmeticError):
    """A motion that cannot be computed."""


class InputTimeoutError(DynamicsError):
    """A live force of which no sample comes."""


class ImpactLawError(DynamicsError):
    """An impact whose law has no solution on the contacts that are closed."""

    @classmethod
    def for_contacts(
        cls,
        contacts: Iterable[str],
        problem: str,
        speeds: Iterable[float],
        restitution: Iterable[float],
        remedy: str = "",
    ) -> "ImpactLawError":
        """Name the contacts, the problem, contact speeds (m/s), restitution and remedy."""
        return cls(
            f"contacts {', '.join(map(repr, contacts))}: {problem} for contact speeds"
            f" {', '.join(f'{speed:g}' for speed in speeds)} m/s with restitution"
            f" {', '.join(f'{eps:g}' for eps in restitution)};"
            f" give contacts that depend on each other a common restitution{remedy}"
        )

# SPDX-License-Identifier: Apache-2.0
"""The six services of a node's parameters, as ROS defines them; no request ends the node.

rclpy converts requests outside of any ``try``, so that one of an unknown type ended the node.
"""

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from typing import TypeVar

from rcl_interfaces.msg import ListParametersResult, ParameterDescriptor, ParameterValue
from rcl_interfaces.msg import Parameter as Given
from rcl_interfaces.msg import SetParametersResult as Result
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameters

from impact_observer.errors import UsageError
from impact_observer.options import USED_AT_THE_START, Option
from impact_observer.plain_text import printable
from impact_observer.process_end import one_line

MOST_NAMES = 1000
"""Names in a request; a longer one is refused, so that estimates do not wait for the answer."""
_LONGEST = 80
"""Characters of a name in an answer."""
_TYPES = {each.value for each in Parameter.Type}

_Answer = TypeVar("_Answer")


class ParameterServices:
    """Answers every request; what cannot be used gets the reason, one for each parameter."""

    def __init__(self, node: Node, table: Iterable[Option]) -> None:
        """Make the services of ``node``, which has declared the parameters of ``table``."""
        self._node, self._rows = node, {each.name: each for each in table}
        for kind, callback in (
            (DescribeParameters, self._describe),
            (GetParameters, self._get),
            (GetParameterTypes, self._get_types),
            (ListParameters, self._list),
            (SetParameters, self._set_each),
            (SetParametersAtomically, self._set_together),
        ):
            snake = "".join(f"_{c.lower()}" if c.isupper() else c for c in kind.__name__)[1:]
            node.create_service(kind, f"~/{snake}", callback, qos_profile=qos_profile_parameters)

    def _describe(
        self, request: DescribeParameters.Request, response: DescribeParameters.Response
    ) -> DescribeParameters.Response:
        response.descriptors = self._of_each(
            request.names, self._node.describe_parameter, ParameterDescriptor
        )
        return response

    def _get(
        self, request: GetParameters.Request, response: GetParameters.Response
    ) -> GetParameters.Response:
        response.values = self._of_each(
            request.names,
            lambda name: self._node.get_parameter(name).get_parameter_value(),
            ParameterValue,
        )
        return response

    def _get_types(
        self, request: GetParameterTypes.Request, response: GetParameterTypes.Response
    ) -> GetParameterTypes.Response:
        response.types = self._of_each(
            request.names, lambda name: self._node.get_parameter(name).type_.value, lambda: 0
        )
        return response

    def _of_each(
        self, names: Sequence[str], read: Callable[[str], _Answer], not_set: Callable[[], _Answer]
    ) -> list[_Answer]:
        """What is read of each of ``names``; of unknown names, or too many, they are not set."""
        known = self._node.has_parameter if len(names) <= MOST_NAMES else lambda _: False
        return [read(each) if known(each) else not_set() for each in names]

    def _list(
        self, request: ListParameters.Request, response: ListParameters.Response
    ) -> ListParameters.Response:
        response.result = ListParametersResult()
        if len(request.prefixes) <= MOST_NAMES:
            response.result = self._node.list_parameters([*request.prefixes], request.depth)
        return response

    def _set_each(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        if (count := len(request.parameters)) > MOST_NAMES:
            response.results = [_refusal(_too_many(count))] * count
        else:
            response.results = [self._set([each]) for each in request.parameters]
        return response

    def _set_together(
        self, request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        count = len(request.parameters)
        response.result = (
            self._set(request.parameters) if count <= MOST_NAMES else _refusal(_too_many(count))
        )
        return response

    def _set(self, given: Iterable[Given]) -> Result:
        """Set all the parameters or none."""
        try:
            return self._node.set_parameters_atomically([self._converted(each) for each in given])
        except UsageError as error:
            return _refusal(str(error))
        except Exception as error:  # noqa: BLE001 (a request must not end the node)
            line = f"parameters: {one_line(error)}"
            self._node.get_logger().error(printable(line))
            return _refusal(line)

    def _converted(self, given: Given) -> Parameter:
        """A parameter that may be set, as rclpy has it.

        Raises:
            UsageError: there is no such parameter, it is read-only, or its type is none.
        """
        shown = given.name if len(given.name) <= _LONGEST else f"{given.name[:_LONGEST]} ..."
        if not self._node.has_parameter(given.name):
            near = get_close_matches(given.name[:_LONGEST], self._known(), 1)
            remedy = f"did you mean {near[0]}?" if near else "list_parameters has the names"
            raise UsageError(f"parameter {shown}: does not exist; {remedy}")
        row = self._rows.get(given.name)
        if self._node.describe_parameter(given.name).read_only:
            why = row.fixed if row else ""
            raise UsageError(f"parameter {shown}: read-only: {why or USED_AT_THE_START}")
        if (kind := given.value.type) not in _TYPES:
            raise UsageError(
                f"parameter {shown}: type {kind} found; expected a type of ParameterType, 1 to"
                f" {max(_TYPES)}"
            )
        converted = Parameter.from_parameter_msg(given)
        if row:
            row.check(converted.value)
        return converted

    def _known(self) -> list[str]:
        """The names of all parameters."""
        return [*self._node.get_parameters_by_prefix("")]


def _refusal(reason: str) -> Result:
    """Nothing is set."""
    return Result(successful=False, reason=printable(reason))


def _too_many(count: int) -> str:
    """Why a long request is refused."""
    return f"{count} parameters in a request; expected at most {MOST_NAMES}"

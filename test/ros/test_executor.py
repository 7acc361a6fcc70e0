"""The executor: subscriptions and timers at once, everything else as ever."""

import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest

rclpy = pytest.importorskip("rclpy")

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from impact_observer.ros.executor import DirectExecutor

pytestmark = pytest.mark.ros


@pytest.fixture
def node(ros_environment: dict[str, str]) -> Iterator[Node]:
    """A node in a domain of its own."""
    assert ros_environment
    rclpy.init(args=[])
    made = Node("probe")
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def executor(node: Node) -> Iterator[DirectExecutor]:
    """It spins that node."""
    made = DirectExecutor()
    made.add_node(node)
    yield made
    made.shutdown()


def spin_until(executor: DirectExecutor, condition: Callable[[], object]) -> None:
    """Fail when it never holds."""
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end, "the condition never held"
        executor.spin_once(0.1)


def test_messages_are_called_for_in_their_order(node: Node, executor: DirectExecutor) -> None:
    """Each once."""
    heard: list[str] = []
    node.create_subscription(String, "said", lambda message: heard.append(message.data), 10)
    publisher = node.create_publisher(String, "said", 10)
    for word in "abc":
        publisher.publish(String(data=word))
    spin_until(executor, lambda: len(heard) == 3)
    assert heard == ["a", "b", "c"]


def test_timers_are_called_for_when_they_are_due(node: Node, executor: DirectExecutor) -> None:
    """Not before, and a cancelled one never."""
    calls: list[float] = []
    node.create_timer(0.05, lambda: calls.append(time.monotonic()))
    node.create_timer(0.01, lambda: calls.append(-1.0)).cancel()
    spin_until(executor, lambda: len(calls) == 3)
    assert all(later - earlier > 0.02 for earlier, later in pairwise(calls))


def test_services_and_clients_are_served(node: Node, executor: DirectExecutor) -> None:
    """They are left to rclpy: a call in this process needs both."""

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        return response

    node.create_service(Trigger, "ask", answer)
    client = node.create_client(Trigger, "ask")
    spin_until(executor, client.service_is_ready)
    future = client.call_async(Trigger.Request())
    spin_until(executor, future.done)
    assert future.result().success


def test_guards_and_tasks_are_called_for(node: Node, executor: DirectExecutor) -> None:
    """Once each."""
    called: list[str] = []
    guard = node.create_guard_condition(lambda: called.append("guard"))
    guard.trigger()
    executor.create_task(lambda: called.append("task"))
    spin_until(executor, lambda: len(called) == 2)
    for _ in range(3):
        executor.spin_once(0.0)
    assert sorted(called) == ["guard", "task"]


def test_events_of_the_middleware_are_told(node: Node, executor: DirectExecutor) -> None:
    """A publisher that offers less than is asked for."""
    told: list[object] = []
    node.create_subscription(
        String,
        "said",
        print,
        QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE),
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=told.append),
    )
    offered = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_publisher(String, "said", offered)
    spin_until(executor, lambda: told)
    assert len(told) == 1


def test_nothing_to_do_returns_after_the_time_given(executor: DirectExecutor) -> None:
    """And at once for none."""
    for _ in range(20):  # what a new node has to do itself
        executor.spin_once(0.05)
    begin = time.monotonic()
    executor.spin_once(0.0)
    executor.spin_once(0.1)
    assert 0.05 < time.monotonic() - begin < 5


def test_errors_of_callbacks_are_raised(node: Node, executor: DirectExecutor) -> None:
    """Whoever spins has to know."""

    def fail() -> None:
        raise LookupError("as it should")

    node.create_timer(0.01, fail)
    with pytest.raises(LookupError, match="as it should"):
        spin_until(executor, lambda: False)


def test_end_of_ros_ends_the_spinning(executor: DirectExecutor) -> None:
    """As with rclpy's own."""
    rclpy.shutdown()
    with pytest.raises(ExternalShutdownException):
        executor.spin_once(0.1)

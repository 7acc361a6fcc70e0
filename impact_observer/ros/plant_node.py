# SPDX-License-Identifier: Apache-2.0
"""The plant node: simulates the impacting system and publishes its impact times."""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from impact_observer.errors import DynamicsError, InputTimeoutError, UsageError
from impact_observer.events import Contacts
from impact_observer.io import interfaces
from impact_observer.io.messages import JointState, LiveSample, read_efforts
from impact_observer.io.recordings import published_model
from impact_observer.model import System, read_model
from impact_observer.model.live_signals import LiveSignals, connected
from impact_observer.model.measurement import read_measurements
from impact_observer.model.multibody import multibody_of
from impact_observer.plant import Plant, SensorModel, SensorSimulation
from impact_observer.ros import parameters
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.intake import Receiver
from impact_observer.ros.plant_sensors import PlantSensors
from impact_observer.ros.sample_intake import silence
from impact_observer.sensor_faults import MEASUREMENT_RATE, SENSOR_FAULTS
from impact_observer.stamps import MAX_STAMP, NS_PER_S, from_seconds
from impact_observer.states import Vector

_LOOK_AHEAD = NS_PER_S
"""How far ahead the next switching is searched, ns."""
_LONGEST_SLEEP = 0.05
"""Longest time between two readings of a clock that the node does not own, s."""
_LONGEST_WAIT = NS_PER_S // 100
"""Longest time between two looks at the newest samples of live forces and grounds, ns."""
_LONGEST_GAP = 10 * NS_PER_S
"""The longest time of the clock between two looks at the clock that is caught up, ns."""
_ACKNOWLEDGE_TIMEOUT = Duration(seconds=1.0)
"""How long the node waits at its end for subscribers to receive the last messages."""
_SETTLING_TIME = 3.5
"""Time from the last subscriber's appearance to the start, s of wall time.

A subscriber that this node has discovered may not have discovered this node yet: DDS repeats a
lost announcement after 3 s only.
"""


class PlantNode(BaseNode):
    """Publishes ``impacts``, true states and the model; owns ``/clock`` on request.

    Events of the simulated sensor are published when they arrive, also after the end of the
    duration. A reset starts with a new sensor, and loses the events in transit.

    While the node is inactive its own clock stands still; with another clock the node publishes
    what was due meanwhile once it is active again. After a longer time than 10 s, and after a jump
    of the clock ahead, a new episode begins instead. The node is done when the duration is over.
    """

    def __init__(self) -> None:
        super().__init__("plant", parameters.PLANT)

    def configure(self) -> None:
        """Implement ``BaseNode``."""
        values = self.values
        self._paused, self._started = time.monotonic_ns(), 0
        self._model = self.with_urdf_of_topic(read_model(values["model"]))
        self._system = multibody_of(self._model)
        self._rate: float = values["rate"]
        self._duration = from_seconds(values["duration"])
        self._factor = values["realtime_factor"]
        self._owns_clock = values["publish_clock"]
        self._clock_period = from_seconds(1.0 / values["clock_rate"])
        self._wanted_subscribers = values["wait_for_subscribers"]
        self._wanted_epoch: int = values["epoch"]
        self._seed = values["seed"]
        self._timeout = values["input_timeout"]
        faults: dict[str, Any] = {t.name: values[f"sensor.{t.name}"] for t in SENSOR_FAULTS}
        self._sensor = SensorModel(**faults)
        self._sensor.check(self._system, self._model.sensors)
        self._check_time_source()
        self._live: LiveSignals | None = None
        if isinstance(self._system, System):
            self._system, self._live = connected(self._system, causal=True)
        self._forces: Receiver[LiveSample] | None = None
        if self._live is not None:
            self._forces = Receiver(
                self,
                interfaces.FORCING,
                self._on_forces,
                read=lambda message, _: read_efforts(message),
                stamp=lambda sample: sample.stamp,
                now=self._clock_now,
            )
        # A motion that no message can change, and that cannot be computed, is the end.
        self.ends_by = (DynamicsError,) if self._live is None else (InputTimeoutError,)
        self._impacts = self.publisher(interfaces.IMPACTS)
        self._states = self.publisher(interfaces.PLANT_JOINT_STATES)
        self._model_topic = self.publisher(interfaces.PLANT_MODEL)
        self._clock_topic = (
            self.publisher(interfaces.SIMULATED_CLOCK) if self._owns_clock else None
        )
        declared = read_measurements(values["measurements"])
        rate = values[MEASUREMENT_RATE.name]
        self._sensors = PlantSensors(self, declared, self._system, rate, self._seed)
        self._closed: Contacts = ()
        text = published_model(self._model, self._seed, self._sensor)
        self._model_topic.publish(self.make.model(text))
        self.serve(Trigger, "~/reset", self._on_reset)
        self._episode = 0
        self._is_held = False
        self._waits_since: float | None = None
        self._waited_at = self._seen = 0
        self._plant: Plant | None = None
        self._ready_since: float | None = None
        # The timer is set to the next thing that is due, in wall time.
        self._timer = self.repeat(_LONGEST_SLEEP, self._on_timer)
        self._timer.cancel()
        waits = "nothing"
        if self._wanted_subscribers:
            waits = f"{self._wanted_subscribers} subscribers on each topic"
        self.introduce(f"model {self._system.name}", waits)
        for line in self._system.remarks(np.zeros((0, 2 * self._system.n))):
            self.lines.info(line)

    def _check_time_source(self) -> None:
        """Refuse two owners of the time, or a pace that others could not follow."""
        simulated = self.get_parameter("use_sim_time").value
        if self._owns_clock and simulated:
            raise UsageError(
                "parameter publish_clock: true together with use_sim_time; choose one"
            )
        if self._factor != 1.0 and not self._owns_clock:
            raise UsageError(
                f"parameter realtime_factor: {self._factor:g} needs publish_clock: true"
            )

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin, or go on; time that the plant owns has stood still."""
        self._started += time.monotonic_ns() - self._paused
        self._paused, self._waits_since = 0, None
        self._timer.reset()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Pause."""
        self._paused = time.monotonic_ns()
        self._timer.cancel()
        return super().on_deactivate(state)

    def _on_timer(self) -> None:
        """Use forces that were ahead of the clock, and publish."""
        if self._forces is not None:
            self._forces.take_arrived()
        if not self.done:
            self._tick()

    def _on_forces(self, samples: Sequence[LiveSample]) -> None:
        """Go on by samples of live forces."""
        assert self._live is not None, "only then they are received"
        for each in samples:
            if problem := self._live.add_force(*each):
                self.lines.warning(f"{interfaces.FORCING.name}: {problem}")
        self._tick()

    def _tick(self) -> None:
        """Publish all messages that are due, in the order of stamps, and set the timer."""
        if self._paused or (self._plant is None and not self._try_to_start()):
            return
        now = self._now()
        if not self._owns_clock and (gap := now - self._seen) > _LONGEST_GAP:
            self._begin_episode(now)
            found = f"the clock is {gap / NS_PER_S:.3f} s ahead, which is not caught up"
            self.note("jumps of the clock", f"{found}: episode {self._episode} begins")
        self._publish_until(now)
        self._seen = now
        if now >= self._end and self._sensing.next_stamp is None:
            self.lines.info(f"{self._duration / NS_PER_S:g} s are over")
            for publisher in (self._impacts, self._states):
                publisher.wait_for_all_acked(_ACKNOWLEDGE_TIMEOUT)
            self.done = True
            return
        self._set_timer(now)

    def _try_to_start(self) -> bool:
        """Start the plant when all subscribers are connected and the clock runs.

        Until then simulated time, if the plant owns it, stands still just before the epoch.
        """
        now = self._wanted_epoch or self.stamp_now()
        if self._clock_topic is not None:
            self._wanted_epoch = now
            self._clock_topic.publish(self.make.clock(max(now - self._clock_period, 1)))
        subscribers = min(
            self._impacts.get_subscription_count(), self._states.get_subscription_count()
        )
        if subscribers < self._wanted_subscribers:
            return False
        self._ready_since = self._ready_since or time.monotonic()
        if self._wanted_subscribers and time.monotonic() < self._ready_since + _SETTLING_TIME:
            return False
        if now == 0:
            return False  # simulated time that has not begun
        if self._live is not None:
            known = self._live.known_until
            if known < now and (self._owns_clock or self._wanted_epoch or not known):
                self._wait_for_inputs(now)
                return False
            now = min(now, known)
        self._start(now)
        return True

    def _wait_for_inputs(self, now: int) -> None:
        """Raise InputTimeoutError if live forces or grounds are missing for too long."""
        self._waits_since = self._waits_since or time.monotonic()
        if time.monotonic() - self._waits_since > self._timeout:
            silent = silence(self._live, now, 0.0)
            raise InputTimeoutError(f"the plant waits: {silent}; input_timeout is over")

    def _start(self, epoch: int) -> None:
        """Start an episode at ``epoch``."""
        self._waits_since = None
        self._plant = Plant(
            self._system,
            *self._model.initial_state(),
            epoch=epoch,
            live=self._live,
        )
        self._plant.next_switching(epoch + _LOOK_AHEAD)
        self._end = epoch + self._duration if self._duration else MAX_STAMP
        self._sensing = SensorSimulation(
            self._sensor,
            self._system,
            sensors=self._model.sensors,
            epoch=epoch,
            last=self._end,
            seed=self._seed,
            episode=self._episode,
        )
        self._epoch, self._closed = epoch, ()
        self._sensors.start(epoch)
        self._started = time.monotonic_ns()  # last, as first calls take long
        self._next_sample = 0
        self._next_clock = epoch
        self._seen = max(epoch, self.stamp_now())  # an epoch that is wanted is caught up with
        name = self._system.name
        self.lines.info(f"{name}: episode {self._episode}, epoch {epoch} ns")

    def _now(self) -> int:
        """The present stamp, ns, or an earlier stamp up to which the live signals are known."""
        now = self._clock_now()
        if self._plant is None or (known := self._plant.known_until) >= now:
            self._waits_since = None
            return now
        self._wait_for_inputs(now)
        known = max(known, self._epoch)
        if self._owns_clock:  # the clock stands still meanwhile
            self._started += int((now - known) / self._factor)
        if self._waited_at != known:
            self._waited_at, self._waits_since = known, None
        return known

    def _clock_now(self) -> int:
        """The time of the clock, ns."""
        if not self._owns_clock:
            return self.stamp_now()
        if self._plant is None:
            return self._wanted_epoch or self.stamp_now()
        return self._epoch + int(
            ((self._paused or time.monotonic_ns()) - self._started) * self._factor
        )

    def _sample_stamp(self, k: int) -> int:
        """Stamp of the true state number ``k``, ns."""
        return self._epoch + round(k * NS_PER_S / self._rate)

    def _publish_until(self, now: int) -> None:
        """Publish all due messages: at equal stamps the event first, the clock last.

        After the end only events in transit are due, and the clock for them.
        """
        assert self._plant is not None
        last = min(now, self._end)
        held = self._system.held_force((last - self._epoch) / NS_PER_S)
        if held and not self._is_held:
            self.lines.warning(held)
        self._is_held = bool(held)
        while (switching := self._plant.next_switching(last)) is not None:
            self._publish_present(switching.instant.stamp - 1)
            self._sensing.detect(switching)
            self._plant.cross(switching)
            self._closed = switching.closed
        self._publish_present(now)
        shown = last if self._sensing.next_stamp is None else now
        if self._clock_topic is not None and shown >= self._next_clock:
            self._clock_topic.publish(self.make.clock(shown))
            late = max(shown - self._next_clock, 0) // self._clock_period
            self._next_clock += (late + 1) * self._clock_period

    def _publish_present(self, last: int) -> None:
        """Publish arriving events and true states up to ``last``, within the present phase."""
        for event, arrival in self._sensing.due(last):
            self._publish_states(arrival - 1)
            self.publish(self._impacts, self.make.event, event)
        self._publish_states(last)

    def _publish_states(self, last: int) -> None:
        """Publish true states of the present phase up to ``last`` and the end."""
        assert self._plant is not None
        n, names = self._system.n, self._system.coordinates
        last = min(last, self._end)
        self._sensors.publish(last, self._state, self._closed)
        while (stamp := self._sample_stamp(self._next_sample)) <= last:
            x = self._state(stamp)
            state = JointState(stamp, names, x[:n], x[n:])
            self.publish(self._states, self.make.joint_state, state)
            self._next_sample += 1

    def _state(self, stamp: int) -> Vector:
        """The true state (q, u) in the present phase, shape (2n,)."""
        assert self._plant is not None
        return np.asarray(self._plant.states(np.array([stamp]))[0])

    def _set_timer(self, now: int) -> None:
        """Set the timer to the next message that is due."""
        wait = max(min(self._next_stamps(now)) - now, 0) / self._factor
        if not self._owns_clock:
            wait = min(wait, _LONGEST_SLEEP * NS_PER_S)
        self._timer.timer_period_ns = max(int(wait), 1000)
        self._timer.reset()

    def _next_stamps(self, now: int) -> Iterator[int]:
        """Stamps of the next messages, at least one."""
        assert self._plant is not None
        if (arrival := self._sensing.next_stamp) is not None:
            yield arrival
        if self._owns_clock:
            yield self._next_clock
        if now < self._end:
            yield self._sample_stamp(self._next_sample)
            if (due := self._sensors.next_stamp) is not None:
                yield due
            switching = self._plant.next_switching(now + _LOOK_AHEAD)
            if switching is not None:
                yield switching.instant.stamp
            if self._live is not None:
                yield now + _LONGEST_WAIT

    def _begin_episode(self, now: int) -> None:
        """Begin a new episode at ``now``, but after all that is published."""
        self._episode += 1
        self._start(max(now, self._sample_stamp(self._next_sample - 1) + 1))

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Restart from the initial state, as a new episode whose epoch is now."""
        if self._plant is None:
            response.success, response.message = False, "the plant has not begun yet"
            return response
        if self._paused:
            response.success, response.message = False, "the plant is inactive: activate it first"
            return response
        self._begin_episode(self._now())
        response.success = True
        response.message = f"episode {self._episode}, epoch {self._epoch} ns"
        return response

# SPDX-License-Identifier: Apache-2.0
"""The diagnostic status of an observer node."""

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from types import MappingProxyType

from diagnostic_msgs.msg import DiagnosticStatus

from impact_observer.errors import ImpactObserverError
from impact_observer.events import Remark, Ruling, Verdict
from impact_observer.io import interfaces
from impact_observer.model.free_parameters import with_unit
from impact_observer.observer import Observer
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

_STALE = 60 * NS_PER_S
"""Time without an impact after which stamps and clock may disagree, ns."""
_LARGE_INNOVATION = 6.0
"""Innovation, in standard deviations, up to which the declared uncertainty explains an event."""
_REFUSAL_HOLDS = 10.0
"""How long the status is not OK after the last refusal, s."""
_BEHIND = 1.0
"""How long an event may wait before the observer counts as behind, s."""
_RULINGS = {
    Ruling.APPLIED: "events applied",
    Ruling.REJECTED: "events rejected",
    Ruling.INSERTED: "impacts inserted",
}
"""Keys of the rulings that are counted here; the observer counts the others as remarks."""
_REFUSALS = (Ruling.REJECTED, Ruling.TOO_LATE, Ruling.UNKNOWN_CONTACT)
_COUNTED = (
    *_RULINGS.values(),
    "from the future",
    "invalid messages",
    "dropped",
    "waited too long",
    "estimates corrected",
    "estimates passed over",
    "clock jumps back",
    "large innovations",
)
_NEW_FAULTS = {
    "missing sequence numbers": "events are missing",
    "impacts inserted": "events were missed by the sensor, and inserted",
    "dropped": "events were dropped, as too many came",
    "waited too long": "events waited for too long",
    "large innovations": "events had a large innovation",
}
"""Faults by the counts that have grown since the last status."""


class ObserverDiagnostics:
    """Counts the actions of an observer node, and makes its diagnostic status.

    Attributes:
        counts: of what happened, by the keys of the status.
        failure: why there is no estimate; empty while there are estimates.
        behind: how far the observer is behind, and the remedy; empty if the observer keeps up.
    """

    def __init__(self, status: Callable[..., DiagnosticStatus], observer: Observer) -> None:
        """Report on the ``observer`` of a node, whose ``status`` makes statuses."""
        self._status, self._observer = status, observer
        self.counts, self._reported = Counter[str](), Counter[str]()
        self.failure = self.behind = ""
        self._latency = 0.0
        self._row = self._refused = self._waiting = 0
        self._why, self._refused_at = "", -math.inf

    def count(self, verdict: Verdict, latency: float) -> None:
        """Count a verdict, given ``latency`` (s) after the stamp of its event."""
        ruling, is_new = verdict.ruling, not verdict.revises
        if ruling in _RULINGS:
            self.counts[_RULINGS[ruling]] += is_new
        self.counts["large innovations"] += verdict.innovation > _LARGE_INNOVATION
        if ruling is Ruling.APPLIED:
            self._row, self._latency = 0, max(self._latency, latency)
        elif ruling in _REFUSALS and is_new:
            self.note_refusal(verdict.reason)

    def note_refusal(self, why: str) -> None:
        """Note that a message or event was not used, and why."""
        self._row += 1
        self._refused += 1
        self._why, self._refused_at = why, time.monotonic()

    def note_backlog(self, count: int, waited: float) -> str:
        """Note that ``count`` events wait, the oldest for ``waited`` (s); a warning, or empty."""
        self._waiting, self.behind, law = count, "", self._observer.law
        if waited > _BEHIND:
            remedies = ["declare clock_error"] if law.uncertainty.clock_error is None else []
            remedy = f"; {', or '.join([*remedies, 'take geometric'])}"
            found = f"{count} events wait, the oldest for {waited:.1f} s"
            cannot = "the observer cannot keep up"
            self.behind = f"{found}: {cannot}{remedy if law.has_covariance else ''}"
        return self.behind

    def status(
        self,
        now: int,
        last: Estimate | None,
        *,
        mismatch: str = "",
        silent: str = "",
        inputs: Mapping[str, object] = MappingProxyType({}),
    ) -> DiagnosticStatus:
        """The status of the observer.

        Args:
            now: time of the clock, ns; 0 while there is none.
            last: the last estimate; None if there is none.
            mismatch: a publisher of impacts of another type or quality of service; else empty.
            silent: the live forces without a sample for too long; else empty.
            inputs: values of the live forces.
        """
        observer = self._observer
        values = {
            "law": observer.law.name,
            **{key: self.counts[key] for key in _COUNTED},
            **{remark.value: observer.remarks[remark] for remark in Remark},
            "waiting": self._waiting,
            "missing sequence numbers": observer.missing,
            "restarts": observer.restarts,
            "largest latency [s]": f"{self._latency:.6f}",
            **inputs,
            **({} if last is None else _estimate_values(last, observer.system.unit)),
            **self._obstacle(last),
        }
        level, message = self._health(now, last, mismatch, silent)
        return self._status("impacts", level, message, values, observer.system.name)

    def _obstacle(self, last: Estimate | None) -> dict[str, object]:
        """Why the last estimate is not synchronized; empty if the estimate is."""
        if last is None or last.synchronized:
            return {}
        try:
            why = self._observer.obstacle(last.stamp)
        except ImpactObserverError:  # the history begins later by now, or there is no motion
            return {}
        return {interfaces.NOT_SYNCHRONIZED: why} if why else {}

    def _health(
        self, now: int, last: Estimate | None, mismatch: str, silent: str
    ) -> tuple[bytes, str]:
        """Level and message of the worst fault."""
        applied = self.counts["events applied"]
        none = (
            f"no event was applied, the last: {self._why}" if self._refused > applied == 0 else ""
        )
        new = self._new_faults()
        if fault := mismatch or self.failure or none:
            return DiagnosticStatus.ERROR, fault
        faults = (self.behind, self._clock_fault(now), silent, _doubt(last), new, self._refusals())
        if fault := next(filter(None, faults), ""):
            return DiagnosticStatus.WARN, fault
        return DiagnosticStatus.OK, f"{applied} impacts applied"

    def _refusals(self) -> str:
        """The latest refusals; empty once events are applied again for some seconds."""
        if not self._row and time.monotonic() - self._refused_at > _REFUSAL_HOLDS:
            return ""
        last = f"the last {self._row}" if self._row else f"{self._refused}"
        return f"{last} events were not applied: {self._why}"

    def _clock_fault(self, now: int) -> str:
        """A fault that explains missing impacts at ``now`` (ns); empty if impacts arrive."""
        observer = self._observer
        if not now:
            return "use_sim_time is set, but no /clock has come"
        if lacking := observer.lacking:
            return f"no sample of an encoder of {', '.join(lacking)} has come yet"
        if observer.start is None:
            return "no impact has come yet"
        silence = now - max(observer.last_event, observer.start, *observer.samples.newest)
        if silence <= _STALE:
            return ""
        return f"the last impact was {silence / NS_PER_S:.0f} s ago by this clock"

    def _new_faults(self) -> str:
        """The faults of events since the last status."""
        counts = self.counts + Counter({"missing sequence numbers": self._observer.missing})
        new = counts - self._reported
        self._reported = counts
        return ", ".join(f"{counts[key]} {what}" for key, what in _NEW_FAULTS.items() if new[key])


def _doubt(last: Estimate | None) -> str:
    """Why an estimate is not to be trusted; empty if the estimate is."""
    if last is None or not (last.inconsistent or last.misfit):
        return ""
    return "events contradict the model or initial_deviation" if last.inconsistent else last.misfit


def _estimate_values(last: Estimate, unit: str) -> dict[str, object]:
    """The parameters, deviations and bounds of an estimate; ``unit`` is of the coordinates."""
    bound, differences = last.bound, last.convergence
    without = "refuted" if last.inconsistent else "none"
    return {
        **{
            with_unit(name, unit): f"{value:.6g} +- {deviation:.2g}"
            for name, value, deviation in last.parameters
        },
        "synchronized": last.synchronized,
        "convergence [J]": f"{differences:.6g}" if differences >= 0 else "one replica only",
        "certified bound of V [J]": f"{bound:.6g}" if bound >= 0 else without,
    }

# SPDX-License-Identifier: Apache-2.0
"""Live forces and grounds from a recording, and in a node that is fed by it."""

from pathlib import Path

import numpy as np
import pytest
from live_rig import RIG, bag, give, samples, simulated
from systems import EPOCH

from impact_observer.cli.main import main
from impact_observer.io.live_inputs import give_recorded, with_recorded
from impact_observer.io.reader import BagReader
from impact_observer.io.writer import BagWriter
from impact_observer.model import parse_model
from impact_observer.observer import Options, make_observer
from impact_observer.stamps import NS_PER_S

INITIAL = "0.3,-0.2,0.5,-0.5"


@pytest.mark.slow
def test_observe_reads_samples_from_a_bag_and_copies_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Estimates are those of an observer that is given the samples; the result can be read again.

    What is no sample is left out, with a warning.
    """
    recorded, once, twice = bag(tmp_path / "rig"), tmp_path / "once", tmp_path / "twice"
    for source, output in ((recorded, once), (once, twice)):
        assert main(["observe", str(source), "--initial-state", INITIAL, "-o", str(output)]) == 0
    assert "warning" not in capsys.readouterr().out
    observer = make_observer(parse_model(RIG, "rig").system, Options(initial_state=INITIAL))
    assert observer.live is not None
    for sample in samples():
        assert give(observer.live, sample) == ""
    for event in simulated()[0]:
        observer.receive(event)
    with BagReader(once) as one, BagReader(twice) as two:
        found = one.observer_states("/observer/state")
        again = two.observer_states("/observer/state")
    assert found.stamps.size > 400
    np.testing.assert_array_equal(found.q, again.q)
    last = observer.estimate(int(found.stamps[-1]))
    np.testing.assert_array_equal(found.q[-1], last.q)
    np.testing.assert_array_equal(found.u[-1], last.u)


def test_samples_that_are_left_out_are_counted(tmp_path: Path) -> None:
    """Half a second of forces that are no numbers is left out, and nothing else."""
    source, odd, lost = bag(tmp_path / "rig"), tmp_path / "odd", 0
    with BagReader(source) as reader, BagWriter(odd) as writer:
        for topic, info in reader.topics.items():
            writer.declare(topic, type_name=info.type, quality=info.quality)
        decode = reader.decoder("/forcing")
        for raw in reader.raw():
            late = raw.log_time - EPOCH
            if raw.topic != "/forcing" or not 4 * NS_PER_S <= late < 4.5 * NS_PER_S:
                writer.write_raw(*raw)
                continue
            message = decode(raw.data)
            message.effort, lost = np.array([np.nan]), lost + 1
            writer.write(raw.topic, raw.log_time, message)
    live = make_observer(parse_model(RIG, "rig").system, Options()).live
    lines: list[str] = []
    with BagReader(odd) as reader:
        (line,) = give_recorded(reader, live)
        system = parse_model(RIG, "rig").system
        with_recorded(reader, system, EPOCH, lines.append)
    assert lines == [line]
    part = f"{lost} of 2501 messages on /forcing wholly or partly left out (10 %)"
    assert lost > 220
    assert line == f"{part}: 'motor': nan found; expected a finite number"

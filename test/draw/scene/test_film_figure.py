# SPDX-License-Identifier: Apache-2.0
"""The figure of a film: positions of bodies, highlighted stops, readable in grey."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from systems import EPOCH, Array, chain, run, sample, system

from impact_observer.draw.scene.film import ContactHistory, Distance, Film, Track, scene_of
from impact_observer.draw.scene.film_figure import DPI, FilmFigure
from impact_observer.draw.scene.scene import Scene
from impact_observer.draw.scene.shapes import hands
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io.bag_part import TimeZero
from impact_observer.model import System, parse_model
from impact_observer.stamps import NS_PER_S

Picture = NDArray[np.uint8]
MS = NS_PER_S // 1000
LAWS = ("geometric", "kinematic")
LIT, PLANT = "#D55E00", "#B9CFE0"
"""Colours of stops that are hit, and of the plant's bodies."""


@cache
def film() -> Film:
    """A film of two_mass over four seconds, with two estimates that approach the plant."""
    model = sample("two_mass").system
    ran = run(model, [0.1, -0.2], [0.5, 0.0], seconds=4.0, rate=50.0)
    cuts = [event.stamp for event in ran.events]
    q, u = ran.states[:, :2], ran.states[:, 2:]
    fading = np.exp(-np.arange(len(q)) / 40.0)[:, None]
    truth = Track.of_states("plant", "", (ran.stamps, q, u), cuts)
    estimates = tuple(
        Track.of_states(law, law, (ran.stamps, q - (i + 1) * fading * 0.2, u), cuts)
        for i, law in enumerate(LAWS)
    )
    return Film(
        scene=scene_of(model, [truth, *estimates]),
        truth=truth,
        estimates=estimates,
        distances=tuple(Distance.between(model, truth, each) for each in estimates),
        contacts=ContactHistory.of_events(model, ran.events),
        zero=TimeZero(EPOCH),
        start=EPOCH,
        end=EPOCH + 4 * NS_PER_S,
    )


class Shown:
    """A film's figure, as pixels and as matplotlib's artists."""

    def __init__(self, film: Film, title: str = "", speed: float = 1.0) -> None:
        self._drawn = FilmFigure(film, title=title, speed=speed)
        self.axes: list[Axes] = self._drawn.figure.axes
        self.canvas: Any = FigureCanvasAgg(self._drawn.figure)

    def show(self, stamp: int) -> None:
        """Move all parts to a stamp."""
        self._drawn.show(stamp)

    def picture(self, stamp: int) -> Picture:
        """The pixels at a stamp."""
        self.show(stamp)
        self.canvas.draw()
        return np.array(self.canvas.buffer_rgba())

    def boxes(self, row: int, colour: str) -> list[Rectangle]:
        """The boxes of one colour in a row that are shown."""
        return [
            each
            for each in self.axes[row].patches
            if isinstance(each, Rectangle)
            and each.get_fill()
            and np.allclose(each.get_facecolor()[:3], to_rgb(colour), atol=1e-3)
            and each.get_visible()
            and not each.get_hatch()
        ]

    def texts(self, row: int) -> list[str]:
        """The texts of a row that are shown."""
        return [each.get_text() for each in self.axes[row].texts if each.get_visible()]


@cache
def shown_film() -> Shown:
    """The figure of ``film``."""
    return Shown(film(), title="two_mass")


def still(model: System, q: Array, **changes: object) -> Film:
    """A film in which nothing moves: a plant alone."""
    stamps = np.array([EPOCH, EPOCH + NS_PER_S])
    states = np.array([q, q])
    truth = Track.of_states("plant", "", (stamps, states, 0 * states), ())
    made = Film(
        scene=scene_of(model, [truth]),
        truth=truth,
        estimates=(),
        distances=(),
        contacts=ContactHistory({}, {}),
        zero=TimeZero(EPOCH),
        start=EPOCH,
        end=EPOCH + NS_PER_S,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def is_colour(picture: Picture, colour: str) -> NDArray[np.bool_]:
    """Mask of the pixels with a colour."""
    wanted = np.rint(np.array(to_rgb(colour)) * 255)
    return np.asarray(np.all(np.abs(picture[..., :3] - wanted) <= 3, axis=-1))


def lit(picture: Picture) -> int:
    """Number of pixels of a stop that is hit."""
    return int(is_colour(picture, LIT).sum())


def test_pictures_have_an_even_number_of_pixels() -> None:
    """Encoders of films want even numbers."""
    height, width, _ = shown_film().picture(EPOCH).shape
    assert (height % 2, width) == (0, 960)


def test_a_picture_depends_on_its_stamp_only() -> None:
    """Earlier pictures do not change a picture."""
    shown = shown_film()
    first = shown.picture(EPOCH + 900 * MS)
    assert not np.array_equal(shown.picture(EPOCH + 2500 * MS), first)
    np.testing.assert_array_equal(shown.picture(EPOCH + 900 * MS), first)


@pytest.mark.parametrize("q", [[0.0, 0.0], [0.2, -0.1], [-0.1, 0.5]])
def test_plant_is_drawn_where_its_frame_says(q: list[float]) -> None:
    """The edges of the blue boxes are right to a pixel."""
    content = still(sample("two_mass").system, np.array(q))
    scene = content.scene
    shown = Shown(content)
    edges = [(x - scene.half, x + scene.half) for x in scene.frame(np.array(q)).bodies]
    to_pixels = shown.axes[0].transData.transform
    expected = [round(float(to_pixels((x, 0))[0])) for pair in edges for x in pair]
    blue = is_colour(shown.picture(EPOCH), PLANT).sum(axis=0) > 5
    turns = np.flatnonzero(np.diff(np.concatenate([[0], blue.astype(int), [0]])))
    drawn = [int(turns[0]), int(turns[-1])]
    np.testing.assert_allclose(drawn, [expected[0], expected[-1]], atol=2)


@pytest.mark.slow
def test_stop_is_highlighted_at_an_impact_and_fades() -> None:
    """The highlight is in every row, and lasts as long in a slow film."""
    shown = shown_film()
    hit = int(film().contacts.hits[0][0])
    before, during = lit(shown.picture(hit - 10 * MS)), lit(shown.picture(hit + MS))
    after = lit(shown.picture(hit + 400 * MS))
    assert before == after == 0
    assert during > 300
    slow = Shown(film(), speed=0.1)
    assert lit(slow.picture(hit + 60 * MS)) == 0
    assert lit(slow.picture(hit + MS // 10)) > 300


def test_stop_is_highlighted_during_persistent_contact() -> None:
    """The highlight lasts from CLOSE to OPEN, without fading."""
    model = sample("two_mass").system
    switches = [(EPOCH + 100 * MS, Kind.CLOSE), (EPOCH + 800 * MS, Kind.OPEN)]
    events = [
        ImpactEvent(stamp, (Switch("stop", kind),), i)
        for i, (stamp, kind) in enumerate(switches, 1)
    ]
    contacts = ContactHistory.of_events(model, events)
    shown = Shown(still(model, np.array([0.0, 0.5]), contacts=contacts))
    bright = [lit(shown.picture(EPOCH + t * MS)) > 100 for t in (50, 110, 700, 790, 810)]
    assert bright == [False, True, True, True, False]


def test_lit_stops_are_dark_in_grey_and_others_are_light() -> None:
    """Stops and bodies differ in a picture without colours."""
    weights = [0.299, 0.587, 0.114]
    assert float(np.dot(to_rgb(LIT), weights)) < 0.55
    assert float(np.dot(to_rgb(PLANT), weights)) > 0.7


def test_axes_of_v_carry_units_and_a_cursor() -> None:
    """The cursor is at the time of the picture, with a dot on each curve."""
    shown = shown_film()
    axes = shown.axes[-1]
    assert axes.get_xlabel().endswith("[s]")
    assert axes.get_ylabel() == "V [J]"
    assert axes.get_yscale() == "log"
    shown.show(EPOCH + 1500 * MS)
    *_, cursor, dots = axes.lines
    assert np.ravel(cursor.get_xdata())[0] == pytest.approx(1.5)
    assert np.ravel(dots.get_xdata()).tolist() == pytest.approx([1.5] * len(LAWS))


def test_rows_have_one_scale_and_names() -> None:
    """The plant is on top; a length to measure by is in the first row."""
    shown = shown_film()
    shown.show(EPOCH)
    assert len({axes.get_xlim() for axes in shown.axes[:3]}) == 1
    assert "plant" in shown.texts(0)
    assert any(text.endswith(" m  ") for text in shown.texts(0))
    assert "dashed: the plant" in shown.texts(1)
    for row, law in enumerate(LAWS, start=1):
        assert law in shown.texts(row)


def test_estimate_without_a_state_says_so() -> None:
    """The row says so before the estimate's first state, while the plant moves on."""
    late = film().estimates[0]
    kept = late.stamps >= EPOCH + NS_PER_S
    late = Track.of_states(
        "late", "geometric", (late.stamps[kept], late.q[kept], late.u[kept]), ()
    )
    shown = Shown(replace(film(), estimates=(late, film().estimates[1])))
    shown.show(EPOCH)
    assert "no state here" in shown.texts(1)
    assert shown.boxes(1, "white") == []
    shown.show(EPOCH + 2 * NS_PER_S)
    assert "no state here" not in shown.texts(1)
    assert len(shown.boxes(1, "white")) == 2


def test_estimates_alone_make_a_film() -> None:
    """A film without truth has no V and no ghost."""
    shown = Shown(replace(film(), truth=None, distances=()))
    assert len(shown.axes) == len(LAWS)
    assert shown.picture(EPOCH).min() == 0


def test_exact_estimate_has_no_distance_to_draw() -> None:
    """Zero, which has no logarithm, gives neither a warning nor a dot."""
    truth = film().truth
    assert truth is not None
    exact = replace(truth, law="geometric", label="geometric")
    zero = Distance(exact.stamps, np.zeros(exact.stamps.size))
    shown = Shown(replace(film(), estimates=(exact,), distances=(zero,)))
    shown.picture(EPOCH + NS_PER_S)
    assert np.size(shown.axes[-1].lines[-1].get_xdata()) == 0


def odd() -> System:
    """A model of full matrices with a wall, a bumper and two other contacts."""
    K = 5 * np.eye(4) - np.ones((4, 4))
    contacts = [
        ([0.0, 0.0, 0.0, -1.0], 0.2, 0.5),
        ([-1.0, 1.0, 0.0, 0.0], 0.1, 0.5),
        ([1.0, 1.0, 1.0, 0.0], 0.3, 0.5),
        ([0.0, -1.0, 2.0, 0.0], 0.3, 0.5),
    ]
    return system(np.eye(4), np.zeros((4, 4)), K, contacts=contacts)


@pytest.mark.parametrize("model", [odd(), chain(20), chain(200)], ids=["odd", "20", "200"])
def test_other_models_fit_into_the_picture(model: System) -> None:
    """Names stay within their bodies."""
    shown = Shown(still(model, 0.1 * np.cos(np.arange(model.n))), title=model.name)
    picture = shown.picture(EPOCH)
    assert picture.shape[0] < 8 * DPI
    names = [each for each in shown.axes[0].texts if each.get_text() in model.coordinates]
    bodies = shown.boxes(0, PLANT)
    assert len(names) == len(bodies) > 3
    for name, body in zip(names, bodies, strict=True):
        inside = body.get_window_extent().padded(2)
        box = name.get_window_extent(shown.canvas.get_renderer())
        assert inside.x0 <= box.x0
        assert box.x1 <= inside.x1
        assert float(name.get_fontsize()) <= 10.0


def falling(direction: float) -> System:
    """A ball whose coordinate is positive upwards, or downwards."""
    ball = sample("bouncing_ball").system
    (floor,) = ball.contacts
    return replace(
        ball,
        forcing=replace(ball.forcing, constant=direction * ball.forcing.constant),
        contacts=(replace(floor, direction=direction * floor.direction),),
    )


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("height", [0.2, 1.0])
def test_a_coordinate_that_falls_stands_upright(direction: float, height: float) -> None:
    """The box is above the floor by the pixels of the gap."""
    shown = Shown(still(falling(direction), np.array([direction * height])))
    axes = shown.axes[0]
    picture = shown.picture(EPOCH)
    boxes = [each for each in axes.patches if isinstance(each, Rectangle) and each.get_hatch()]
    floor = picture.shape[0] - boxes[0].get_window_extent().y1
    box = np.flatnonzero(is_colour(picture, PLANT).any(axis=1))
    low, high = axes.get_ylim()
    metre = axes.bbox.height / (high - low)
    assert floor - box.max() == pytest.approx(height * metre, abs=3)


def test_tracks_that_stand_upright_are_beside_each_other() -> None:
    """Tracks have one scale, which the first track shows."""
    content = still(falling(1.0), np.array([0.5]))
    assert content.truth is not None
    estimate = replace(content.truth, label="geometric", law="geometric")
    shown = Shown(replace(content, estimates=(estimate,)))
    first, second = (axes.get_position() for axes in shown.axes)
    assert (first.y0, first.height, first.width) == (second.y0, second.height, second.width)
    assert second.x0 == pytest.approx(first.x1)
    assert shown.axes[0].get_ylim() == shown.axes[1].get_ylim()
    assert any(text.endswith(" m  ") for text in shown.texts(0))


def test_a_coordinate_on_a_spring_lies() -> None:
    """Systems of several coordinates lie, too; only a falling coordinate has an up and a down."""
    ball = falling(1.0)
    for model in (replace(ball, K=np.eye(1)), sample("two_mass").system):
        assert still(model, np.zeros(model.n)).scene.up == 0
    assert still(ball, np.zeros(1)).scene.up == 1


def test_what_turns_has_a_hand_at_its_angle() -> None:
    """The hand stands upright at zero and leans by the angle; the scale is in radians."""
    model = parse_model(
        """name: pendulum
unit: rad
bodies: [{name: arm, mass: 0.02}]
springs: [{between: [ground, arm], stiffness: 1}]
stops: [{name: right, body: arm, limit: 0.5, side: above, restitution: 0.7}]
""",
        "pendulum",
    ).system
    scene = Scene.of_system(model)
    for angle in (0.0, 0.4, -0.3):
        (hand,) = hands(scene, scene.frame(np.array([angle])), 3.0)
        along, across = (hand[1] - hand[0]) / [3.0, 1.0]
        assert np.arctan2(along, across) == pytest.approx(angle)
    stamps = np.array([EPOCH, EPOCH + NS_PER_S])
    truth = Track.of_states("plant", "", (stamps, np.array([[0.0], [0.4]]), np.zeros((2, 1))), ())
    film = still(model, np.zeros(1), scene=scene_of(model, [truth]), truth=truth)
    drawn = FilmFigure(film, title="", speed=1.0)
    texts = [text.get_text() for axes in drawn.figure.axes for text in axes.texts]
    assert any(" rad = " in text for text in texts)

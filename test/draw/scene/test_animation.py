# SPDX-License-Identifier: Apache-2.0
"""Pictures of films: positions of bodies, highlighted stops, readable in grey."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from systems import EPOCH, Array, chain, run, sample, system

from impact_observer.draw.scene import row
from impact_observer.draw.scene.animation import DPI, FilmPictures
from impact_observer.draw.scene.film import ContactHistory, Distance, Film, Track, scene_of
from impact_observer.draw.scene.row import LARGE
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.stamps import NS_PER_S

Picture = NDArray[np.uint8]
MS = NS_PER_S // 1000
LAWS = ("geometric", "kinematic")


@cache
def film() -> Film:
    """Four seconds of two_mass, with two estimates that come nearer to it."""
    model = sample("two_mass").system
    ran = run(model, [0.1, -0.2], [0.5, 0.0], seconds=4.0, rate=50.0)
    cuts = [event.stamp for event in ran.events]
    q, u = ran.states[:, :2], ran.states[:, 2:]
    fading = np.exp(-np.arange(len(q)) / 40.0)[:, None]
    truth = Track.of("plant", "", (ran.stamps, q, u), cuts)
    estimates = tuple(
        Track.of(law, law, (ran.stamps, q - (i + 1) * fading * 0.2, u), cuts)
        for i, law in enumerate(LAWS)
    )
    return Film(
        scene=scene_of(model, [truth, *estimates]),
        truth=truth,
        estimates=estimates,
        distances=tuple(Distance.between(model, truth, each) for each in estimates),
        contacts=ContactHistory.of(model, ran.events),
        epoch=EPOCH,
        start=EPOCH,
        end=EPOCH + 4 * NS_PER_S,
    )


@cache
def pictures() -> FilmPictures:
    """The pictures of that film."""
    return FilmPictures(film(), title="two_mass")


def still(model: System, q: Array, **changes: object) -> Film:
    """A film in which nothing moves: a plant alone."""
    stamps = np.array([EPOCH, EPOCH + NS_PER_S])
    states = np.array([q, q])
    truth = Track.of("plant", "", (stamps, states, 0 * states), ())
    made = Film(
        scene=scene_of(model, [truth]),
        truth=truth,
        estimates=(),
        distances=(),
        contacts=ContactHistory({}, {}),
        epoch=EPOCH,
        start=EPOCH,
        end=EPOCH + NS_PER_S,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def is_colour(picture: Picture, colour: str) -> NDArray[np.bool_]:
    """Which pixels have a colour."""
    wanted = np.rint(np.array(to_rgb(colour)) * 255)
    return np.asarray(np.all(np.abs(picture[..., :3] - wanted) <= 3, axis=-1))


def lit(picture: Picture) -> int:
    """How many pixels are of a stop that is hit."""
    return int(is_colour(picture, row._LIT).sum())


def test_pictures_have_an_even_number_of_pixels() -> None:
    """As encoders of films want them."""
    moving = pictures()
    picture = moving.picture(EPOCH)
    assert picture.shape == (moving.size[1], moving.size[0], 4)
    assert picture.dtype == np.uint8
    assert moving.size[0] % 2 == moving.size[1] % 2 == 0


def test_a_picture_depends_on_its_stamp_only() -> None:
    """Not on those that were taken before it."""
    moving = pictures()
    first = moving.picture(EPOCH + 900 * MS)
    assert not np.array_equal(moving.picture(EPOCH + 2500 * MS), first)
    np.testing.assert_array_equal(moving.picture(EPOCH + 900 * MS), first)


@pytest.mark.parametrize("q", [[0.0, 0.0], [0.2, -0.1], [-0.1, 0.5]])
def test_plant_is_drawn_where_its_frame_says(q: list[float]) -> None:
    """Left and right edges of the blue boxes, to a pixel."""
    shown = still(sample("two_mass").system, np.array(q))
    scene = shown.scene
    moving = FilmPictures(shown, title="")
    row = moving._rows[0].axes
    edges = [(x - scene.half, x + scene.half) for x in scene.frame(np.array(q)).bodies]
    expected = [round(float(row.transData.transform((x, 0))[0])) for pair in edges for x in pair]
    blue = is_colour(moving.picture(EPOCH), "#B9CFE0").sum(axis=0) > 5
    turns = np.flatnonzero(np.diff(np.concatenate([[0], blue.astype(int), [0]])))
    found = [int(turns[0]), int(turns[-1])]
    np.testing.assert_allclose(found, [expected[0], expected[-1]], atol=2)


@pytest.mark.slow
def test_stop_is_highlighted_at_an_impact_and_fades() -> None:
    """In every row, and as long in a slow film."""
    shown = film()
    moving = pictures()
    hit = int(shown.contacts.hits[0][0])
    before, at = lit(moving.picture(hit - 10 * MS)), lit(moving.picture(hit + MS))
    after = lit(moving.picture(hit + 400 * MS))
    assert before == after == 0
    assert at > 300
    slow = FilmPictures(shown, title="", speed=0.1)
    assert lit(slow.picture(hit + 60 * MS)) == 0
    assert lit(slow.picture(hit + MS // 10)) > 300


def test_stop_is_highlighted_during_persistent_contact() -> None:
    """From CLOSE to OPEN, without fading."""
    model = sample("two_mass").system
    switches = [(EPOCH + 100 * MS, Kind.CLOSE), (EPOCH + 800 * MS, Kind.OPEN)]
    events = [
        ImpactEvent(stamp, (Switch("stop", kind),), i)
        for i, (stamp, kind) in enumerate(switches, 1)
    ]
    shown = still(model, np.array([0.0, 0.5]), contacts=ContactHistory.of(model, events))
    moving = FilmPictures(shown, title="")
    bright = [lit(moving.picture(EPOCH + t * MS)) > 100 for t in (50, 110, 700, 790, 810)]
    assert bright == [False, True, True, True, False]


def test_lit_stops_are_dark_in_grey_and_others_are_light() -> None:
    """So they differ in a picture without colours."""
    grey = float(np.dot(to_rgb(row._LIT), [0.299, 0.587, 0.114]))
    assert grey < 0.55
    assert float(np.dot(to_rgb("#B9CFE0"), [0.299, 0.587, 0.114])) > 0.7


def test_axes_of_v_carry_units_and_a_cursor() -> None:
    """The future lies under a veil."""
    moving = pictures()
    below = moving._distances
    assert below is not None
    axes = below._cursor.axes
    assert axes is not None
    assert axes.get_xlabel().endswith("[s]")
    assert axes.get_ylabel() == "V [J]"
    assert axes.get_yscale() == "log"
    moving.picture(EPOCH + 1500 * MS)
    assert np.ravel(below._cursor.get_xdata())[0] == pytest.approx(1.5)
    assert below._veil.get_x() == pytest.approx(1.5)
    assert below._veil.get_x() + below._veil.get_width() == pytest.approx(4.0)
    assert np.size(below._dots.get_xdata()) == len(LAWS)


def test_rows_have_one_scale_and_names() -> None:
    """Plant on top; a length to measure by is in the first row."""
    moving = pictures()
    limits = {row.axes.get_xlim() for row in moving._rows}
    assert len(limits) == 1
    texts = [[text.get_text() for text in row.axes.texts] for row in moving._rows]
    assert "plant" in texts[0]
    assert any(text.endswith(" m  ") for text in texts[0])
    assert "dashed: the plant" in texts[1]
    for law, shown in zip(LAWS, texts[1:], strict=True):
        assert law in shown


@pytest.mark.slow
def test_estimate_without_a_state_says_so() -> None:
    """Before its first one, while the plant moves on."""
    shown = film()
    late = shown.estimates[0]
    kept = late.stamps >= EPOCH + NS_PER_S
    late = Track.of("late", "geometric", (late.stamps[kept], late.q[kept], late.u[kept]), ())
    moving = FilmPictures(replace(shown, estimates=(late, shown.estimates[1])), title="")
    row = moving._rows[1]
    moving.picture(EPOCH)
    assert row._absent.get_visible()
    assert not row._bodies[0].get_visible()
    moving.picture(EPOCH + 2 * NS_PER_S)
    assert not row._absent.get_visible()
    assert row._bodies[0].get_visible()


def test_estimates_alone_make_a_film() -> None:
    """Without truth there is no V and no ghost."""
    shown = replace(film(), truth=None, distances=())
    moving = FilmPictures(shown, title="")
    assert moving._distances is None
    assert len(moving._rows) == len(LAWS)
    assert moving.picture(EPOCH).min() == 0


def test_exact_estimate_has_no_distance_to_draw() -> None:
    """Zero has no logarithm: neither a warning nor a dot."""
    shown = film()
    assert shown.truth is not None
    exact = replace(shown.truth, law="geometric", label="geometric")
    zero = Distance(exact.stamps, np.zeros(exact.stamps.size))
    moving = FilmPictures(replace(shown, estimates=(exact,), distances=(zero,)), title="")
    moving.picture(EPOCH + NS_PER_S)
    assert moving._distances is not None
    assert np.size(moving._distances._dots.get_xdata()) == 0


def odd() -> System:
    """Full matrices; a wall, a bumper and two contacts that are neither."""
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
    """Names stay within their bodies, and what is left out is written."""
    shown = still(model, 0.1 * np.cos(np.arange(model.n)))
    moving = FilmPictures(shown, title=model.name)
    picture = moving.picture(EPOCH)
    assert picture.shape[0] < 8 * DPI
    row = moving._rows[0]
    for name, body in zip(row._names, row._bodies, strict=True):
        inside = body.get_window_extent().padded(2)
        box = name.get_window_extent(moving._canvas.get_renderer())
        assert inside.x0 <= box.x0
        assert box.x1 <= inside.x1
        assert float(name.get_fontsize()) <= LARGE


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
    """Its box is above the floor, by as many pixels as the gap has."""
    moving = FilmPictures(still(falling(direction), np.array([direction * height])), title="")
    axes = moving._rows[0].axes
    picture = moving.picture(EPOCH)
    boxes = [each for each in axes.patches if isinstance(each, Rectangle) and each.get_hatch()]
    floor = picture.shape[0] - boxes[0].get_window_extent().y1
    box = np.flatnonzero(is_colour(picture, "#B9CFE0").any(axis=1))
    low, high = axes.get_ylim()
    metre = axes.bbox.height / (high - low)
    assert floor - box.max() == pytest.approx(height * metre, abs=3)


def test_tracks_that_stand_upright_are_beside_each_other() -> None:
    """At one scale, which the first of them shows."""
    shown = still(falling(1.0), np.array([0.5]))
    assert shown.truth is not None
    estimate = replace(shown.truth, label="geometric", law="geometric")
    moving = FilmPictures(replace(shown, estimates=(estimate,)), title="")
    first, second = (row.axes.get_position() for row in moving._rows)
    assert (first.y0, first.height, first.width) == (second.y0, second.height, second.width)
    assert second.x0 == pytest.approx(first.x1)
    assert moving._rows[0].axes.get_ylim() == moving._rows[1].axes.get_ylim()
    assert any(text.get_text().endswith(" m  ") for text in moving._rows[0].axes.texts)


def test_a_coordinate_on_a_spring_lies() -> None:
    """As do systems of several coordinates; only what falls has an up and a down."""
    ball = falling(1.0)
    for model in (replace(ball, K=np.eye(1)), sample("two_mass").system):
        assert still(model, np.zeros(model.n)).scene.up == 0
    assert still(ball, np.zeros(1)).scene.up == 1

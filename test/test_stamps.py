# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Times since the epoch that keep what a float rounds."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.stamps import NS_PER_S, Elapsed

DAY = 86_400 * NS_PER_S


@given(ns=st.integers(0, 10**4 * DAY), seconds=st.floats(-10.0, 10.0))
@examples(100)
def test_elapsed_times_keep_what_a_float_rounds(ns: int, seconds: float) -> None:
    """Sums and differences are as accurate as the seconds that are added."""
    begin = Elapsed(ns, 1e-10)
    later = begin + seconds
    assert isinstance(later, Elapsed)
    assert math.isclose(later - begin, seconds, rel_tol=1e-15, abs_tol=1e-24)
    assert math.isclose(begin - (begin - seconds), seconds, rel_tol=1e-15, abs_tol=1e-24)


def test_elapsed_times_are_numbers_of_seconds() -> None:
    """To all that needs no more digits."""
    begin: float = Elapsed(3 * NS_PER_S // 2)
    assert begin == 1.5
    assert hash(begin) == hash(1.5)
    assert 2 * begin == 3.0
    assert (begin + np.array([0.0, 1.0])).tolist() == [1.5, 2.5]
    assert (begin - np.array([0.0, 1.0])).tolist() == [1.5, 0.5]


def test_elapsed_times_that_differ_by_less_than_a_float_shows_are_not_equal() -> None:
    """So nothing that is kept for one is taken for the other."""
    one, other = Elapsed(DAY), Elapsed(DAY, 1e-13)
    assert float(one) == float(other)
    assert one != other

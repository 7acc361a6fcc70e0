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

"""States of a linear chain given all measurements, by conditioning on all of them at once."""

import numpy as np

from impact_observer.smooth.chain import Normal, Step
from impact_observer.states import Matrix, Vector


def conditioned(first: Normal, steps: list[Step]) -> tuple[list[Vector], list[Matrix], float]:
    """Means and covariances of all states given all measurements, and their log density.

    All states are functions of one vector of independent errors.
    """
    size = first.root.shape[1] + sum(each.N.shape[1] for each in steps)
    F, c, used = np.zeros((len(first.mean), size)), first.mean, first.root.shape[1]
    F[:, :used] = first.root
    maps, offsets, rows, values, noises = [F], [c], [], [], []
    for step in steps:
        F, c = step.A @ F, step.A @ c + step.b
        F[:, used : used + step.N.shape[1]] += step.N
        used += step.N.shape[1]
        maps.append(F)
        offsets.append(c)
        rows.append(step.H @ F)
        values.append(step.y - step.H @ c)
        noises += np.sum(step.V**2, axis=1).tolist()
    H, y = np.vstack(rows), np.concatenate(values)
    S = H @ H.T + np.diag(noises)
    mean, P = H.T @ np.linalg.solve(S, y), np.eye(size) - H.T @ np.linalg.solve(S, H)
    density = -(y @ np.linalg.solve(S, y) + np.linalg.slogdet(2 * np.pi * S)[1]) / 2
    means = [c + F @ mean for F, c in zip(maps, offsets, strict=True)]
    return means, [F @ P @ F.T for F in maps], float(density)

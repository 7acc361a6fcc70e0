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

"""Threads of the linear algebra library."""

import os


def one_matrix_thread(*, always: bool = False) -> None:
    """Limit the linear algebra of this process to one thread; call it before numpy is imported.

    More threads are no faster for small matrices, are many times slower where other processes use
    the processor too, and can change the last bit: node and command would differ.

    Args:
        always: even where the environment says another number.
    """
    for library in ("OPENBLAS", "MKL", "OMP", "BLIS"):
        name = f"{library}_NUM_THREADS"
        os.environ[name] = "1" if always else os.environ.get(name, "1")

"""What a change of the currents costs in a map of saturating iron, part by part.

    python scripts/current_changes.py MAP [--sets N]

Prints milliseconds of processor time, on one thread: of currents drawn at random from the map's domain, each without
knowledge of the others, and of currents along a closed path through the domain in 1000 steps, with `follow_currents`.
Prints figures, not verdicts.
"""

import argparse
import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import time  # noqa: E402
from collections.abc import Callable  # noqa: E402

import numpy as np  # noqa: E402

from fieldmap.kernels.map.reduced_iron import newton  # noqa: E402
from fieldmap.lookup import interpolate  # noqa: E402
from fieldmap.lookup.current_model import CurrentModel  # noqa: E402
from fieldmap.store import read_map  # noqa: E402
from fieldmap.store.reduced_model import ReducedModel  # noqa: E402

STEPS, REPETITIONS = 1000, 5


def path(model: ReducedModel) -> np.ndarray:
    """Currents (n, c) along a closed path through the domain."""
    angle = 2 * np.pi * np.arange(STEPS) / STEPS
    d = len(model.lower)
    phases = angle[:, None] * np.arange(1, d + 1) + np.arange(d)
    return model.domain.at(0.5 + 0.4 * np.sin(phases))


def milliseconds(work: Callable[[], object], count: int) -> float:
    """Least processor time of several runs over count, after one that compiles."""
    work()
    seconds = []
    for _ in range(REPETITIONS):
        start = time.process_time_ns()
        work()
        seconds.append(time.process_time_ns() - start)
    return 1e-6 * min(seconds) / count


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("map", help="file of a map of saturating iron")
    parser.add_argument("--sets", type=int, default=200, help="currents drawn at random")
    options = parser.parse_args()
    data = read_map(options.map)
    model = data.reduced_model
    if model is None:
        parser.error(f"{options.map}: a map of linear iron, which superposes")
    sets = model.domain.at(np.random.default_rng(5).random((options.sets, len(model.lower))))
    current_model = CurrentModel(model, data.coil_names)
    opened = interpolate(data)
    follower = CurrentModel(model, data.coil_names, follow=True)
    along = path(model)
    print(f"{len(model.weights)} points, {len(model.constant)} modes, {len(model.output)} fields")
    predict = milliseconds(lambda: [current_model._predicted(i) for i in sets], len(sets))
    print(f"start from known states  {predict:.3f} ms")
    for near, words in ((False, "this start"), (True, "the nearest state")):
        mean = np.mean([steps(current_model, currents, near) for currents in sets])
        print(f"Newton steps from {words}: {mean:.2f}")
    everything = milliseconds(lambda: [current_model.weights(i) for i in sets], len(sets))
    print(f"weights of the fields, any currents         {everything:.3f} ms")
    everything = milliseconds(lambda: [follower.weights(i) for i in along], len(along))
    print(f"weights of the fields, along a trajectory   {everything:.3f} ms")
    point = 0.5 * (opened.lower + opened.upper)
    opened.at(sets[0])
    lookup = milliseconds(lambda: [opened.field_and_gradient(point, sets[0]) for _ in range(1000)], 1000)
    print(f"field and gradient at a point, same currents {lookup:.4f} ms")


def steps(model: CurrentModel, currents: np.ndarray, near: bool) -> int:
    """Newton steps from the usual start, or from the nearest known state."""
    data = model.model
    begin, factor = model._predicted(currents)
    if near:
        away = (((data.known_currents - currents) / model._range) ** 2).sum(axis=1)
        begin = data.known_amplitudes[away.argmin()]
    return newton(data.source @ currents, *model._iron, model._constant, begin, factor, 1e-6, 60)[1]


if __name__ == "__main__":
    main()

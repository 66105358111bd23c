"""Where the machine of a scenario rests."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.dynamics.closed_loop import Machine
from fieldmap.dynamics.scenario.controller_keys import ConstantKeys
from fieldmap.dynamics.scenario.reader import Scenario
from fieldmap.dynamics.trim import Trim, trim
from fieldmap.errors import Infeasible

MILLI = 1e-3


def rest_at(scenario: Scenario, machine: Machine, depth_mm: float, guess: ArrayLike) -> Trim:
    """Where the machine of a scenario rests at a depth, with x and y or their signals as at its start.

    guess (3,): outputs near those. Raises NoEquilibrium, and Infeasible where it takes more than the amplifiers give.
    """
    contents = scenario.contents
    nan = np.nan
    place = [nan, nan, -MILLI * (contents.sensors.zero_depth_mm + depth_mm)]
    outputs = [nan, nan, nan]
    for k, (given, keys) in enumerate(
        ((contents.start.x_mm, contents.control.x), (contents.start.y_mm, contents.control.y))
    ):
        if given is not None:
            place[k] = MILLI * given
        else:
            outputs[1 + k] = (
                keys.output if isinstance(keys, ConstantKeys) and keys.output is not None else 0.0
            )
    rest = trim(machine, place, outputs, guess)
    low, high = machine.drive.steady
    beyond = np.maximum(rest.currents - high, low - rest.currents)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 1e-9 * max(1.0, abs(rest.currents[worst])):
        limit = (high if rest.currents[worst] > 0 else low)[worst]
        must = f"the body must rest with what the amplifiers give and the supply drives, {limit:.4g} A"
        received = f"{rest.currents[worst]:.3g} A"
        remedy = "begin higher or nearer to the axis, or state a field.scale"
        raise Infeasible(scenario.error("start", must, received, remedy).problems[0])
    return rest


def rests_at(scenario: Scenario, machine: Machine, rest: Trim, depths_mm: Sequence[float]) -> list[Trim]:
    """Where it rests at each of these depths, as `rest_at`; rest: the one at its start.

    The search goes from the start outward, each time from the rest nearest to the depth.
    """
    start = scenario.start_depth_mm
    known = {start: rest}
    for depth in sorted(depths_mm, key=lambda depth: abs(depth - start)):
        if depth not in known:
            nearest = min(known, key=lambda there: abs(there - depth))
            known[depth] = rest_at(scenario, machine, depth, known[nearest].outputs)
    return [known[depth] for depth in depths_mm]

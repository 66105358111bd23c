"""Results of the estimators of fieldmap.control.identification for the thesis's vertical loop, by Monte Carlo.

Prints the tables of docs/theory/identification.md and docs/thesis_identification.md. The plant is (5-17), the
controller (5-11), the noise is that of Table 3-8; everything else is stated in the tables. Takes a minute or two.
"""

import itertools

import numpy as np
import scipy.optimize

from fieldmap.control import (
    PID,
    closed_loop,
    from_roots,
    pid_transfer_function,
    sampled,
    simulate_loop,
    transfer_function,
)
from fieldmap.control.identification import (
    Orders,
    armax,
    generalised_least_squares,
    identify_direct,
    identify_indirect,
    identify_two_stage,
    least_squares,
    modified_least_squares_runs,
    pseudo_random_binary,
    recursive_least_squares,
    root_locus,
)
from fieldmap.errors import FieldmapError

TS, SENSOR = 2e-3, 0.0104
PLANT, ORDERS = from_roots(-0.03, [0.9935], [1.01, 0.905]), Orders(poles=2, zeros=1)


def controller(Kc, Td=0.001):
    """The controller, with a negative gain for the plant's negative gain."""
    c = pid_transfer_function(Kc, 0.007, Td, TS)
    return transfer_function(-c.numerator, c.denominator)


def records(Kc, runs, noise=SENSOR, reference=None, force=0.0, Td=0.001):
    """Reference (n,), control and measured position (runs, n); by default with a PRBS of order eight and 1 mm."""
    r = pseudo_random_binary(8, samples=4080) if reference is None else reference
    e, d = np.random.default_rng(11).normal(size=(2, runs, r.size))
    pid = PID(Kc, 0.007, Td, TS, integration="trapezoidal", acts_on_minus_error=True)
    run = simulate_loop(PLANT, pid, r, runs=runs, position_noise=noise * e, disturbance=force * d)
    return r, run.u, run.y + noise * e


def estimators(Kc):
    """Name -> function of r, u, y."""
    return {
        "least squares": lambda r, u, y: least_squares(y, u, ORDERS, TS).model,
        "generalised, order 2": lambda r, u, y: generalised_least_squares(y, u, ORDERS, TS).model,
        "recursive, 0.98": lambda r, u, y: recursive_least_squares(y, u, ORDERS, forgetting=0.98).model,
        "modified (direct)": lambda r, u, y: identify_direct(y, u, ORDERS, TS).model,
        "ARMAX": lambda r, u, y: armax(y, u, ORDERS, TS).model,
        "indirect": lambda r, u, y: identify_indirect(y, r, controller(Kc), ORDERS, TS).model,
        "two-stage": lambda r, u, y: identify_two_stage(y, u, r, ORDERS, TS, loop=Orders(4, 4)).model,
    }


def bias_table(runs=20):
    """Poles and zero, mean and spread, of each estimator for three kinds of noise."""
    for title, options in (
        ("sensor noise of Table 3-8", {}),
        ("ten times that", {"noise": 10 * SENSOR}),
        ("that of Table 3-8 and an unseen force of 1.5 V", {"force": 1.5}),
    ):
        print(f"\n{title}; K_c = 0.5, {runs} records of 4080 samples: pole 1.01, pole 0.905, zero 0.9935")
        r, u, y = records(0.5, runs, **options)
        for name, estimate in estimators(0.5).items():
            found = []
            for k in range(runs):
                try:
                    model = estimate(r, u[k], y[k])
                except FieldmapError:
                    continue
                found.append([*np.sort(model.poles.real)[::-1], model.zeros[0].real])
            if found:
                mean, spread = np.mean(found, axis=0), np.std(found, axis=0)
                cells = "  ".join(f"{m:8.4f} ± {s:.4f}" for m, s in zip(mean, spread, strict=True))
            print(f"  {name:22s} {cells if found else 'none settled':54s} {len(found)} of {runs}")


def recovery_table(runs=100):
    """The modified least squares with the plant's own structure, and with the structure of Table 5-1."""
    for Kc in (0.5, 0.15):
        r, u, y = records(Kc, runs)
        direct = modified_least_squares_runs(y, u, ORDERS)
        off = 100 * np.abs(np.column_stack([direct.poles / [1.01, 0.905], direct.zeros / 0.9935]) - 1)
        print(
            f"\nK_c = {Kc}: worst of {runs} records, % of pole 1.01, pole 0.905, zero: {off.max(axis=0).round(3)}"
        )
        full = modified_least_squares_runs(y, r, Orders(poles=4, zeros=3), iterations=20)
        print(f"  structure (5-13) on r, y: {full.converged.sum()} of {runs} settled after 20 iterations")
        for name, roots in (("poles", full.poles), ("zeros", full.zeros)):
            cells = ", ".join(
                f"{m:.4f} ± {s:.4f}"
                for m, s in zip(np.mean(roots, axis=0), np.std(roots, axis=0), strict=True)
            )
            print(f"  {name} {cells}")
        reduced = modified_least_squares_runs(y, r, Orders(poles=3, zeros=1))
        print(
            f"  structure (5-15): {reduced.converged.sum()} settled, poles {reduced.poles.mean(axis=0).round(4)}"
        )


def identifiability():
    """Condition of the regressors from u and y with and without a reference signal."""
    still = np.zeros(4080)
    for name, reference, Td in (
        ("PID, PRBS reference", None, 0.001),
        ("PID, no reference", still, 0.001),
        ("PI, no reference", still, 0.0),
    ):
        _, u, y = records(0.5, 1, noise=0.1, reference=reference, Td=Td)
        try:
            print(f"  {name:22s} condition {least_squares(y[0], u[0], ORDERS, TS).condition:.0f}")
        except FieldmapError as error:
            print(f"  {name:22s} refused: {error.problems[0].received}")


def locus_table():
    """Poles of (5-17) at the gains of Table 5-2."""
    for Kc in (0.5, 0.334, 0.2, 0.15):
        print(f"  {Kc:5.3f}", root_locus(PLANT, controller(1.0), [Kc]).poles[0].round(4))


def newtonian_fits():
    """Fits of g / (s^2 + d s - c), or with a lag instead of d, to Table 5-2 at K_c = 0.334, 0.2, 0.15."""
    table = {0.334: [0.9743 + 0.0246j], 0.2: [0.9899 + 0.0207j, 0.9896], 0.15: [0.9956 + 0.0167j, 0.9858]}

    def misses(x, unit, lagging):
        g, c = 1e3 * x[0], 1e2 * x[1]
        bottom = np.polymul([1e-2 * abs(x[2]), 1.0], [1.0, 0.0, -c]) if lagging else [1.0, 10 * x[2], -c]
        plant, found = sampled(([g], bottom), TS), []
        for Kc, printed in table.items():
            poles = closed_loop(plant, pid_transfer_function(Kc, 0.007 * unit, 0.001 * unit, TS)).poles
            found += [poles[np.argmin(np.abs(poles - pole))] - pole for pole in printed]
        return np.concatenate([np.real(found), np.imag(found)])

    for name, unit, lagging in (
        ("minutes, d", 60, False),
        ("minutes, lag", 60, True),
        ("seconds, d", 1, False),
    ):
        starts = itertools.product((0.01, 0.1, 1.6), (-2.0, 0.1, 1.5), (0.1, 1.5, 4.0))
        fits = (scipy.optimize.least_squares(misses, start, args=(unit, lagging)) for start in starts)
        fit = min(fits, key=lambda found: found.cost)
        g, c, third = fit.x * [1e3, 1e2, 10.0]
        last = f"lag {abs(third):.2g} ms" if lagging else f"d {third:.2g} 1/s"
        rms = np.sqrt(np.mean(fit.fun**2))
        print(f"  {name:13s} g {g:7.1f} mm/s2 per V, c {c:7.1f} 1/s2, {last}, poles missed by {rms:.4f} rms")


if __name__ == "__main__":
    recovery_table()
    bias_table()
    print("\nfrom u and y alone:")
    identifiability()
    print("\nclosed-loop poles of (5-17):")
    locus_table()
    print("\nNewtonian plants for Table 5-2, times of the controller in minutes or seconds:")
    newtonian_fits()

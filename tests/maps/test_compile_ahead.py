"""The list of kernels that another process compiles: what runs really call, and files that runs really find."""

import os
import subprocess
import sys

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.kernels import compile_ahead
from fieldmap.kernels.compile_ahead import listed
from fieldmap.lookup import open_map
from fieldmap.sources import unit_flux_densities, unit_flux_density_and_gradient

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="nothing is compiled in this run"
)


@pytest.mark.filterwarnings("ignore::fieldmap.errors.MapAccuracyWarning")
def test_what_is_listed_is_what_a_map_calls(request):
    """Types that no run asks for would be compiled in vain, and those that it asks for by the run itself."""
    entries = list(listed())
    before = {entry.kernel: set(entry.kernel.signatures) for entry in entries}
    # Here, unless a test before this one has asked for the map.
    opened = open_map(request.getfixturevalue("few_states_map").path)
    coil = read_device("drive_unit").coils[0]
    unit_flux_densities([coil], np.zeros((2, 3)))
    unit_flux_density_and_gradient(coil, np.zeros((2, 3)))
    middle = (opened.lower + opened.upper) / 2
    opened.field(middle, [1.0, 0.5])
    opened.gradient(middle, [1.0, 0.5])
    opened.second_gradient(middle, [1.0, 0.5])
    calls = {entry: set(entry.kernel.signatures) for entry in entries}
    assert [entry.kernel.py_func.__name__ for entry, used in calls.items() if not used] == []
    for (kernel, arguments), used in calls.items():
        # Tests before this one may have called it with others.
        if not before[kernel]:
            assert used == {arguments}
        assert arguments in used


def test_a_process_leaves_what_another_finds(tmp_path):
    """The list itself, cut to two kernels, in an empty cache."""
    two = "\ngrowing_cholesky solve_lower d2 i d1\ngrowing_cholesky solve_upper d2 i d1\n"
    of_two = f"from fieldmap.kernels import compile_ahead as c\nc.KERNELS = {two!r}\n"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def run(code):
        done = subprocess.run(
            [sys.executable, "-c", of_two + code], env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    ask = "print(*[entry.is_cached for entry in c.listed()])"
    assert run(ask) == ["False", "False"]
    run("c._compile_all()")
    assert run(ask) == ["True", "True"]
    use = (
        "import numpy as np\nfrom numba.core import event\nfirst, second = c.listed()\nout = np.array([6.0, 8.0])\n"
        "with event.install_recorder('numba:compile') as recorder:\n"
        "    first.kernel(np.diag([2.0, 4.0]), 2, out)\n    second.kernel(np.diag([2.0, 4.0]), 2, out)\n"
        "print(*out, sum(first.kernel.stats.cache_hits.values()), len(first.kernel.stats.cache_misses))\n"
        "print(len(recorder.buffer))"
    )
    assert run(use) == ["1.5", "0.5", "1", "0", "0"]


def test_no_process_starts_where_all_is_compiled_nor_outlives_the_block(monkeypatch):
    started = []

    class Process:
        def __init__(self, *arguments, **options):
            started.append(self)
            self.ended = False

        def terminate(self):
            self.ended = True

        def wait(self):
            assert self.ended

    monkeypatch.setattr(compile_ahead.subprocess, "Popen", Process)
    monkeypatch.setattr(compile_ahead.numba.config, "NUMBA_NUM_THREADS", 2)
    for cached, count in ((True, 0), (False, 1)):
        monkeypatch.setattr(compile_ahead.Entry, "is_cached", cached)
        with pytest.raises(ZeroDivisionError), compile_ahead.compiled_ahead():
            1 / 0  # noqa: B018
        assert [process.ended for process in started] == [True] * count

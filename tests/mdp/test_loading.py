"""When a process loads compiled loops: `mdp.lazy`."""

import subprocess
import sys
from threading import current_thread, main_thread

import numpy as np
import pytest

from exact_mdp.mdp import MDP, lazy
from exact_mdp.solvers import solve

SESSION = """
import sys
from threading import current_thread, main_thread
from exact_mdp import MDP, check, evaluate, solve
from exact_mdp.solvers import ValueIteration
chances = [[["1/2", "1/2"], ["1/3", "2/3"]], [[0, 1], [1, 0]]]
mdp = MDP.from_arrays(chances, [[1, 2], [0, "1/2"]], "9/10", layout="ass")
found = []
for call in ({calls}):
    call()
    found.append("numba" in sys.modules)
print(found)
"""


def printed(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


@pytest.mark.parametrize(
    ("calls", "loaded"),
    [
        (["solve(mdp)", "solve(mdp)"], [False, True]),
        (["evaluate(mdp, [0, 0])", "ValueIteration().solve(mdp)"], [False, True]),
        (["check(mdp, [0, 0])", "solve(mdp)"], [False, True]),
    ],
)
def test_a_session_loads_the_loops_in_its_second_call(calls: list[str], loaded: list[bool]) -> None:
    code = SESSION.format(calls="".join(f"lambda: {call}, " for call in calls))
    assert printed(code).strip() == str(loaded)


def test_commands_on_the_published_scenario_load_no_loops() -> None:
    commands = [
        "solve yuan2025",
        "solve yuan2025 --certify",
        "evaluate yuan2025 optimal",
        "check yuan2025 optimal",
        "returns yuan2025 optimal",
        "info yuan2025",
    ]
    code = (
        "import sys; from exact_mdp.analysis.cli import main\n"
        f"for words in {commands}:\n"
        "    sys.argv = ['exact-mdp', *words.split()]\n"
        "    try: main()\n"
        "    except SystemExit as end: assert end.code == 0, words\n"
        "print('numba' in sys.modules)"
    )
    assert printed(code).splitlines()[-1] == "False"


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that has just begun, and loads nothing."""
    begun = type(lazy._process)(command=False, calls=0, inside=False, loops=0)
    monkeypatch.setattr(lazy, "_process", begun)
    monkeypatch.setattr(lazy, "LOOPS", "not loaded")
    monkeypatch.setattr(lazy, "_compiler_loads", lambda: True)


def small() -> bool:
    return lazy.loops_pay(100, least=lazy.COMPILED)


@pytest.mark.usefixtures("fresh")
def test_a_command_loads_the_loops_after_many_in_numpy() -> None:
    lazy.as_command()
    for _ in range(5):
        lazy.asked(lambda: None)()
    assert [small() for _ in range(lazy.MANY)] == [False] * lazy.MANY
    assert small()
    assert lazy.loops_pay(lazy.COMPILED, least=lazy.COMPILED)


@pytest.mark.usefixtures("fresh")
def test_a_large_model_is_worth_the_loops_at_once_and_is_not_counted() -> None:
    for _ in range(2 * lazy.MANY):
        assert lazy.loops_pay(lazy.COMPILED, least=lazy.COMPILED)
    assert not small()


@pytest.mark.usefixtures("fresh")
def test_calls_that_fail_count_and_end() -> None:
    @lazy.asked
    def fails() -> None:
        raise ValueError

    for loaded in (False, True):
        with pytest.raises(ValueError):
            fails()
        assert small() == loaded
    assert not lazy._process.inside


@pytest.mark.usefixtures("fresh")
def test_calls_on_the_way_are_not_counted() -> None:
    costs = MDP.from_arrays([np.full((2, 2), 0.5)] * 2, [[1, 2], [0, 3]], 0.9, sense="min")
    solve(costs)  # by the model of which it is the negation
    assert lazy._process.calls == 1


@pytest.mark.parametrize(
    ("error", "told"),
    [
        ("ModuleNotFoundError('No module named numba', name='numba')", "numba is not installed"),
        ("ImportError('Numba needs another NumPy')", "Numba needs another NumPy"),
    ],
)
def test_a_session_without_the_compiler_goes_on_and_says_so_once(error: str, told: str) -> None:
    broken = (
        "import sys, warnings\n"
        "class Broken:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == 'numba': raise {error}\n"
        "sys.meta_path.insert(0, Broken())\n"
        "caught = warnings.catch_warnings(record=True)\n"
        "heard = caught.__enter__()\n"
        "warnings.simplefilter('always')\n"
    )
    calls = "lambda: solve(mdp), lambda: solve(mdp), lambda: check(mdp, [0, 0]), "
    code = broken + SESSION.format(calls=calls) + "print([str(each.message) for each in heard])"
    found, heard = printed(code).splitlines()
    assert found == str([False] * 3)
    assert heard.count("loops are not compiled") == 1
    assert told in heard


def test_an_interrupt_does_not_reach_what_is_being_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    threads = []
    monkeypatch.setattr(lazy, "load", lambda name: threads.append((name, current_thread())))
    assert lazy._compiler_loads.__wrapped__()
    assert [name for name, _ in threads] == [lazy.LOOPS]
    assert threads[0][1] is not main_thread()

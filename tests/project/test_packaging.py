"""The wheel: what is in it, and that it works where the source is not."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ["mdp", "solvers", "analysis", "paper_repro"]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
NOT_PACKAGED = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc", ".ipynb_checkpoints")

# One group: the tests run in one process, which builds the wheel once.
pytestmark = [pytest.mark.wheel, pytest.mark.xdist_group("wheel")]


@dataclass(frozen=True)
class Installed:
    """An environment that has the wheel, and an empty folder to work in."""

    bin: Path
    site_packages: Path
    folder: Path

    def run(self, program: str, *arguments: str, cwd: Path | None = None) -> str:
        found = shutil.which(program, path=str(self.bin))
        assert found is not None, f"no {program} in {self.bin}"
        done = subprocess.run(
            [found, *arguments],
            cwd=cwd or self.folder,
            env=environment(),
            capture_output=True,
            text=True,
            encoding="utf-8",
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


def environment() -> dict[str, str]:
    """Return this process's environment less what would let it import from elsewhere."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return kept | {"PYTHONUTF8": "1", "COLUMNS": "100", "NO_COLOR": "1"}


def call(*command: str | Path, cwd: Path) -> None:
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, done.stdout


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what the wheel is built from."""
    copy = tmp_path_factory.mktemp("source")
    for name in ["pyproject.toml", "hatch_build.py", ".gitignore", "LICENSE", "README.md"]:
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, copy)
    shutil.copytree(ROOT / "exact_mdp", copy / "exact_mdp", ignore=NOT_PACKAGED)
    return copy


@pytest.fixture(scope="session")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", source, tmp_path_factory.mktemp("wheel") / "out")


def build(kind: str, source: Path, out: Path) -> Path:
    """Build a wheel or a source archive of a folder, and return it."""
    out.mkdir()
    call(sys.executable, "-m", "build", f"--{kind}", "--no-isolation", "-o", out, source, cwd=out)
    (found,) = out.iterdir()
    return found


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel in an environment of its own, which borrows the dependencies installed here.

    The folder of the dependencies is added by a .pth file. Such a folder's own .pth files are
    not read, and so the editable installation that is among them is not seen.
    """
    home = tmp_path_factory.mktemp("venv")
    venv.create(home, symlinks=os.name != "nt", with_pip=False)
    where = {"base": str(home), "platbase": str(home), "installed_base": str(home)}
    scripts = Path(sysconfig.get_path("scripts", "venv", vars=where))
    site_packages = Path(sysconfig.get_path("purelib", "venv", vars=where))
    python = scripts / ("python.exe" if os.name == "nt" else "python")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(python)]
    call(*pip, "install", "--no-index", "--no-deps", wheel, cwd=home)
    borrowed = dict.fromkeys([sysconfig.get_path("purelib"), sysconfig.get_path("platlib")])
    (site_packages / "dependencies.pth").write_text("\n".join(borrowed) + "\n", "utf-8")
    return Installed(scripts, site_packages, tmp_path_factory.mktemp("elsewhere"))


def test_wheel_holds_every_file_of_the_packages_and_nothing_else(source: Path, wheel: Path) -> None:
    expected = {
        path.relative_to(source).as_posix()
        for path in (source / "exact_mdp").rglob("*")
        if path.is_file()
    }
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == expected
    assert {f"exact_mdp/{package}/py.typed" for package in PACKAGES} <= held
    assert "exact_mdp/mdp/scenarios/yuan2025.toml" in held


def test_built_again_it_is_the_same_wheel(source: Path, wheel: Path, tmp_path: Path) -> None:
    """From the folder, touched since, and from the source archive, which is the same twice, too."""
    (source / "pyproject.toml").touch()
    assert build("wheel", source, tmp_path / "again").read_bytes() == wheel.read_bytes()
    first, second = (build("sdist", source, tmp_path / name) for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()
    shutil.unpack_archive(first, tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert build("wheel", unpacked, tmp_path / "third").read_bytes() == wheel.read_bytes()


def test_a_clone_without_links_builds_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    """Git for Windows writes a link as a text file: only the short names at the top are lost."""
    clone = tmp_path / "clone"
    call("git", "-c", "core.symlinks=false", "clone", "-q", "--no-local", ROOT, clone, cwd=tmp_path)
    assert (clone / "mdp").is_file()
    with zipfile.ZipFile(build("wheel", clone, tmp_path / "out")) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    committed = subprocess.run(
        ["git", "ls-files", "exact_mdp"], cwd=clone, capture_output=True, text=True, check=True
    )
    assert held == set(committed.stdout.split())


def test_a_package_without_its_folders_is_not_built(source: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(source, broken)
    shutil.rmtree(broken / "exact_mdp" / "mdp")
    (broken / "exact_mdp" / "mdp").write_text("../mdp")
    done = subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", "out", broken],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0
    assert "exact_mdp/mdp/__init__.py is missing" in done.stdout + done.stderr
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_wheel_describes_the_project(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        about = {
            name.partition(".dist-info/")[2]: archive.read(name).decode()
            for name in archive.namelist()
            if ".dist-info/" in name
        }
    assert f"\nName: {PROJECT['name']}\n" in about["METADATA"]
    assert f"\nVersion: {PROJECT['version']}\n" in about["METADATA"]
    assert "exact-mdp = exact_mdp.analysis.cli:main" in about["entry_points.txt"]
    assert about["licenses/LICENSE"] == (ROOT / "LICENSE").read_text("utf-8")
    assert "py3-none-any" in wheel.name


def test_one_name_is_installed(installed: Installed) -> None:
    """Nothing but exact_mdp goes into site-packages: a project may have names of its own."""
    rooms = [f"exact_mdp.{name}" for name in PACKAGES]
    names = ", ".join(rooms)
    code = f"import exact_mdp, {names}; print(*[m.__file__ for m in [{names}]])"
    files = [Path(name) for name in installed.run("python", "-c", code).split()]
    home = installed.site_packages / "exact_mdp"
    assert [file.parent for file in files] == [home / name for name in PACKAGES]
    assert not [name for name in PACKAGES if (installed.site_packages / name).exists()]


OWN_TEST = """
import analysis, mdp, solvers
from exact_mdp import MDP


def test_own_modules_are_found():
    assert (analysis.MINE, mdp.MINE, solvers.MINE) == (1, 2, 3)


def test_a_policy_is_held_against_the_optimum(policy_gate):
    model = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    policy_gate(model, [1, 0])
"""


def test_a_project_with_modules_of_these_names_runs_its_tests(installed: Installed) -> None:
    """A repository's own analysis/, solvers/ and mdp.py live beside the installed package."""
    project = installed.folder / "project"
    for name, number in (("analysis/__init__", 1), ("mdp", 2), ("solvers/__init__", 3)):
        path = project / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"MINE = {number}\n")
    (project / "test_own.py").write_text(OWN_TEST)
    command = ["-m", "pytest", "-q", "-p", "no:cacheprovider", str(project)]
    said = installed.run("python", *command, cwd=project)
    assert "2 passed" in said, said


def test_the_installed_program_works(installed: Installed) -> None:
    assert installed.run("exact-mdp", "--version").strip() == f"exact-mdp {PROJECT['version']}"
    assert json.loads(installed.run("exact-mdp", "info", "yuan2025", "--json"))
    installed.run("python", "-c", "import click, jinja2, numpy, scipy")

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
ROOMS = ["mdp", "solvers", "analysis", "paper_repro"]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
NOT_PACKAGED = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc", ".ipynb_checkpoints")

# One group: the tests run in one process, which builds the wheel once.
pytestmark = [pytest.mark.wheel, pytest.mark.xdist_group("wheel")]


def call(*command: str | Path, cwd: Path, status: int = 0) -> str:
    """What a program prints, without what would let it import from elsewhere."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, text=True, encoding="utf-8",
        env=own | {"PYTHONUTF8": "1", "COLUMNS": "100", "NO_COLOR": "1"},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    assert done.returncode == status, done.stdout
    return done.stdout


def build(kind: str, source: Path, out: Path) -> Path:
    """Build a wheel or a source archive of a folder, and return it."""
    out.mkdir()
    call(sys.executable, "-m", "build", f"--{kind}", "--no-isolation", "-o", out, source, cwd=out)
    (archive,) = out.iterdir()
    return archive


def contents(wheel: Path) -> tuple[set[str], dict[str, str]]:
    """The files of a wheel, and what it says of itself."""
    with zipfile.ZipFile(wheel) as archive:
        about = {name for name in archive.namelist() if ".dist-info/" in name}
        texts = {name.split(".dist-info/")[1]: archive.read(name).decode() for name in about}
        return set(archive.namelist()) - about, texts


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


@dataclass(frozen=True)
class Installed:
    """An environment that has the wheel, and an empty folder to work in."""

    bin: Path
    site_packages: Path
    folder: Path

    def run(self, program: str, *arguments: str, cwd: Path | None = None) -> str:
        path = shutil.which(program, path=str(self.bin))
        assert path is not None, f"no {program} in {self.bin}"
        return call(path, *arguments, cwd=cwd or self.folder)


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


def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(
    source: Path, wheel: Path
) -> None:
    files = {path for path in (source / "exact_mdp").rglob("*") if path.is_file()}
    inside, about = contents(wheel)
    assert inside == {path.relative_to(source).as_posix() for path in files}
    assert {f"exact_mdp/{room}/py.typed" for room in ROOMS} <= inside
    assert "exact_mdp/mdp/scenarios/yuan2025.toml" in inside
    assert f"\nName: {PROJECT['name']}\n" in about["METADATA"]
    assert f"\nVersion: {PROJECT['version']}\n" in about["METADATA"]
    assert "exact-mdp = exact_mdp.analysis.cli:main" in about["entry_points.txt"]
    assert about["licenses/LICENSE"] == (ROOT / "LICENSE").read_text("utf-8")
    assert "py3-none-any" in wheel.name


def test_built_again_it_is_the_same_wheel(source: Path, wheel: Path, tmp_path: Path) -> None:
    """From the folder, touched since, and from the source archive, which is the same twice, too."""
    (source / "pyproject.toml").touch()
    assert build("wheel", source, tmp_path / "again").read_bytes() == wheel.read_bytes()
    first, second = (build("sdist", source, tmp_path / name) for name in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()
    (tmp_path / "unpacked").mkdir()  # unpack_archive has no filter= before Python 3.11.4
    subprocess.run(["tar", "-xzf", first, "-C", tmp_path / "unpacked"], check=True)
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert build("wheel", unpacked, tmp_path / "third").read_bytes() == wheel.read_bytes()


def test_a_clone_without_links_builds_the_wheel_and_one_without_rooms_none(tmp_path: Path) -> None:
    """Git for Windows writes a link as a text file: only the short names at the top are lost."""
    clone = tmp_path / "clone"
    call("git", "-c", "core.symlinks=false", "clone", "-q", "--no-local", ROOT, clone, cwd=tmp_path)
    assert (clone / "mdp").is_file()
    files, _ = contents(build("wheel", clone, tmp_path / "out"))
    assert files == set(call("git", "ls-files", "exact_mdp", cwd=clone).split())
    shutil.rmtree(clone / "exact_mdp" / "mdp")
    (clone / "exact_mdp" / "mdp").write_text("../mdp")
    words = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", "none", clone]
    assert "exact_mdp/mdp/__init__.py is missing" in call(*words, cwd=tmp_path, status=1)
    assert not list(tmp_path.glob("none/*"))


def test_the_installed_program_works(installed: Installed) -> None:
    assert installed.run("exact-mdp", "--version").strip() == f"exact-mdp {PROJECT['version']}"
    assert json.loads(installed.run("exact-mdp", "info", "yuan2025", "--json"))
    installed.run("python", "-c", "import click, jinja2, numpy, scipy")

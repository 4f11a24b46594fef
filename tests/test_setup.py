# SPDX-License-Identifier: Apache-2.0
"""The set-up: one version of each package, needs that have all that they ask for, and a sentence
where nothing can be reached.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from coincid.tools import locked, system
from coincid.tools.locked import _what_to_do, missing, uv_options

ROOT = Path(__file__).parents[1]
LOCKS = sorted(ROOT.glob("requirements*.lock"))
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "optional-dependencies"
]
MARKED = {"extra": ""}


def names(lock):
    found = re.findall(r"^([\w.-]+)==", lock.read_text(encoding="utf-8"), re.MULTILINE)
    return [canonicalize_name(name) for name in found]


def brought(need):
    """Return the locks that `scripts/setup need` installs, as the script itself says."""
    text = (ROOT / "scripts" / "setup").read_text(encoding="utf-8")
    case = re.search(rf"^ +{need}\) echo ([\w ]+) ;;", text, re.MULTILINE)
    parts = case[1].split() if case else [need]
    chosen = [ROOT / f"requirements-{part}.lock" for part in parts]
    return [ROOT / "requirements.lock", *filter(Path.exists, chosen)]


def asked_for(requirement, seen):
    """Add the name of a requirement, and all that it asks for, as far as that is installed here."""
    name = canonicalize_name(requirement.name)
    if name in seen or not (requirement.marker is None or requirement.marker.evaluate(MARKED)):
        return
    if name == "coincid":
        for extra in requirement.extras:
            for line in EXTRAS[extra]:
                asked_for(Requirement(line), seen)
        return
    seen.add(name)
    with suppress(PackageNotFoundError):
        for line in requires(name) or []:
            asked_for(Requirement(line), seen)


def test_every_package_has_one_version():
    found = [name for lock in LOCKS for name in names(lock)]
    assert sorted(set(found)) == sorted(found)


@pytest.mark.parametrize("need", [None, *EXTRAS])
def test_a_need_brings_all_that_it_asks_for(need):
    lines = EXTRAS[need] if need else requires("coincid")
    seen = set()
    for line in lines:
        asked_for(Requirement(line), seen)
    locked = {name for lock in brought(need) for name in names(lock)}
    assert not seen - locked


def test_uv_looks_where_pip_looks(tmp_path):
    mirror = "https://mirror.example"
    variables = {
        "NO_INDEX": "1",
        "INDEX_URL": mirror,
        "EXTRA_INDEX_URL": f"{tmp_path.as_uri()}/not-there https://more.example",
    }
    of_environment = (
        f":env:.{name.lower().replace('_', '-')}={value!r}\n" for name, value in variables.items()
    )
    settings = (
        f"global.find-links='{tmp_path}\\n{tmp_path}/not-there'\n"
        f"{''.join(of_environment)}"
        "global.timeout='9'\n"
    )
    wanted = [
        "--find-links",
        str(tmp_path),
        "--no-index",
        "--default-index",
        mirror,
    ]
    assert uv_options(settings) == [*wanted, "--index", "https://more.example"]


@pytest.mark.parametrize("name", ["wheels", "my wheels", "räder"])
def test_folders_of_wheels_are_found_by_their_addresses(tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    for place in ([str(folder)] if " " not in name else []) + [folder.as_uri()]:
        assert uv_options(f":env:.find-links='{place}'\n") == ["--find-links", place]


UV = ["/bin/uv", "--quiet", "pip", "install", "--python", sys.executable]
PIP = ["my clone/python", "-m", "pip"]


@pytest.mark.parametrize(
    ("uv", "failing", "programs"),
    [
        ("/bin/uv", (), ["/bin/uv"]),
        ("/bin/uv", ("/bin/uv",), ["/bin/uv", PIP[0]]),
        ("/bin/uv", ("/bin/uv", PIP[0]), ["/bin/uv", PIP[0]]),
        (None, (), [PIP[0]]),
        ("", (PIP[0],), [PIP[0]]),
    ],
)
def test_uv_installs_all_locks_and_pip_where_uv_cannot(
    monkeypatch, tmp_path, uv, failing, programs
):
    """Neither takes what the packages ask for, and pip asks nobody and does not wait for long. If both
    fail, a sentence says what to do.
    """
    locks = [str(tmp_path / name) for name in ("a.lock", "b.lock")]
    for lock in locks:
        Path(lock).write_text("not-there==1.0\n", encoding="utf-8")
    run = []

    def noted(command, log):
        run.append(command)
        return command[0] not in failing

    monkeypatch.setattr(locked, "_run", noted)
    monkeypatch.setattr(locked, "_pip_settings", lambda pip: "global.no-index='true'\n")
    monkeypatch.setattr(locked, "LOG", tmp_path / "log")
    monkeypatch.setenv("COINCID_PIP", "\n".join(PIP))
    monkeypatch.delenv("COINCID_UV", raising=False)
    if uv is not None:
        monkeypatch.setenv("COINCID_UV", uv)
    if programs[-1] in failing:
        with pytest.raises(SystemExit, match="^missing Python packages: not-there==1.0, .* says"):
            locked.install(locks)
    else:
        locked.install(locks)
    files = ["-r", locks[0], "-r", locks[1]]
    quick = ["--no-input", "--disable-pip-version-check", "--retries", "1", "--timeout", "15"]
    commands = {
        "/bin/uv": [*UV, "--no-index", "--no-deps", *files],
        PIP[0]: [*PIP, "install", *quick, "--no-deps", "--no-compile", *files],
    }
    assert run == [commands[program] for program in programs]


@pytest.mark.parametrize("code", [0, 1])
def test_the_log_of_an_installation_has_its_commands_and_what_they_say(tmp_path, code):
    """Output and errors; nothing of it is shown."""
    path = tmp_path / "log"
    words = f"import sys; print('out', flush=True); print('err', file=sys.stderr); sys.exit({code})"
    with path.open("w", encoding="utf-8") as log:
        for _ in range(2):
            assert locked._run([sys.executable, "-c", words], log) == (code == 0)
    lines = path.read_text(encoding="utf-8").splitlines()
    told = "$ " + shlex.join([sys.executable, "-c", words])
    assert lines == [told, "out", "err"] * 2


@pytest.mark.parametrize("yes", ["1", "true", "Yes", "on"])
def test_an_index_is_left_out_only_where_pip_leaves_it_out(yes):
    for no in ("0", "false", "no", "off", ""):
        assert uv_options(f"global.no-index='{no}'\n") == []
    assert uv_options(f"install.no-index='{yes}'\n") == ["--no-index"]


def test_pip_is_asked_for_its_settings_and_one_that_fails_has_none():
    """So uv or pip is tried all the same."""
    says = "import sys; print(sys.argv[1:] == ['config', 'list']); sys.exit({})"
    answers = [locked._pip_settings([sys.executable, "-c", says.format(code)]) for code in (0, 1)]
    assert answers == ["True\n"] * 2
    assert uv_options(answers[1]) == uv_options("") == []


def test_missing_packages_are_found(tmp_path):
    lock = tmp_path / "some.lock"
    lock.write_text(
        "# pytest==0\nnot-there==1.0\npytest==0.1\npackaging==" + version("packaging") + "\n",
        encoding="utf-8",
    )
    assert missing([str(lock)]) == ["not-there==1.0", "pytest==0.1"]


@pytest.mark.parametrize("packages", range(1, 7))
def test_every_missing_package_is_named_or_counted(tmp_path, packages):
    lock = tmp_path / "some.lock"
    lines = [f"not-there-{k}==1.0" for k in range(packages)]
    lock.write_text("\n".join([*lines, ""]), encoding="utf-8")
    told = _what_to_do([str(lock)])
    assert f"-r {lock}" in told
    named = sum(line in told for line in lines)
    more = re.search(r" and (\d+) more;", told)
    assert named + (int(more[1]) if more else 0) == packages
    assert not more or int(more[1]) > 0


def test_the_set_up_ends_where_system_packages_cannot_be_installed(tmp_path):
    command = [sys.executable, str(ROOT / "tools" / "system.py"), "one", "two"]
    done = subprocess.run(
        command,
        env=os.environ | {"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("missing system packages; run")
    assert done.stderr.endswith("apt-get install -y one two\n")


@pytest.fixture
def machine(monkeypatch):
    """Return a function that makes up a machine: its programs, the user, and the commands that fail
    there. The commands that are run are noted.
    """
    run = []

    def machine(*programs, root=False, failing=()):
        run.clear()
        monkeypatch.setattr(system.os, "geteuid", lambda: 0 if root else 1000)
        monkeypatch.setattr(system, "which", lambda name: name if name in programs else None)

        def noted(*command):
            run.append(" ".join(command))
            failed = any(word in run[-1] for word in failing)
            return subprocess.CompletedProcess(command, int(failed), stdout="apt's words")

        monkeypatch.setattr(system, "_run", noted)
        return run

    return machine


@pytest.mark.parametrize("code", [0, 3])
def test_of_a_command_for_system_packages_output_errors_and_code_are_known(code, capfd):
    """None of it is shown, and nobody is asked: sudo and apt-get find the end of their input."""
    words = f"cat; echo räder; echo err >&2; exit {code}"
    done = system._run("sh", "-c", words)
    assert (done.returncode, done.stdout) == (code, "räder\nerr\n")
    assert capfd.readouterr() == ("", "")


APT = "env DEBIAN_FRONTEND=noninteractive apt-get -qq"
WANTED = "install -y --no-install-recommends one two"


@pytest.mark.parametrize(("root", "prefix"), [(True, ""), (False, "sudo -n ")])
def test_system_packages_are_installed_as_root_or_by_sudo(machine, capsys, root, prefix):
    """A list that cannot be renewed is no error, if the packages are found."""
    for failing in ((), (" update",)):
        run = machine("apt-get", "sudo", root=root, failing=failing)
        system.system_packages("one", "two")
        assert run[0] == f"{prefix}true"
        assert run[1] == f"{prefix}{APT} update"
        assert run[2].startswith(f"{prefix}{APT} -o DPkg::Lock::Timeout=")
        assert run[2].endswith(f" {WANTED}") and len(run) == 3
        assert capsys.readouterr().err == "installing system packages: one two\n"


@pytest.mark.parametrize(
    ("programs", "root", "failing", "told"),
    [
        (("apt-get",), False, (), "; run as root: apt-get update && apt-get install -y one two"),
        (("sudo",), False, (), "; run: sudo apt-get update && sudo apt-get install -y one two"),
        (("apt-get", "sudo"), False, ("-n true",), "; run: sudo apt-get update && sudo apt-get"),
        (("apt-get", "sudo"), True, ("install",), "; run: apt-get update && apt-get install"),
        ((), True, (), "; run: apt-get update && apt-get install -y one two"),
    ],
)
def test_who_may_not_install_is_told_the_command(machine, capsys, programs, root, failing, told):
    """With sudo where it is there and the user is not root."""
    run = machine(*programs, root=root, failing=failing)
    with pytest.raises(system.MissingPackagesError) as refused:
        system.system_packages("one", "two")
    assert str(refused.value).startswith(f"missing system packages{told}")
    tried = any("install" in command for command in run)
    assert tried == ("install" in failing)
    assert ("apt's words" in capsys.readouterr().err) == tried


def test_two_installations_of_system_packages_take_turns(machine, monkeypatch):
    """Because apt-get does not wait for its lists, as it does for packages."""
    machine("apt-get", root=True)
    together, calls = threading.Barrier(2), []

    def noted(*command):
        if command == ("true",):
            together.wait(60)
        else:
            calls.append(threading.get_ident())
            time.sleep(0.02)
        return subprocess.CompletedProcess(command, 0, stdout="")

    monkeypatch.setattr(system, "_run", noted)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(system.system_packages, ("one", "two")))
    first, *_, last = calls
    assert calls == [first, first, last, last] and first != last


def test_without_a_registry_one_sentence_says_what_to_do(tmp_path):
    python = [sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv")]
    subprocess.run(python, check=True)
    lock = tmp_path / "some.lock"
    lock.write_text("not-there==1.0\n", encoding="utf-8")
    environment = os.environ | {"PIP_NO_INDEX": "1", "COINCID_PIP": f"{sys.executable}\n-m\npip"}
    program = tmp_path / "venv" / "bin" / "python"
    command = [str(program), str(ROOT / "tools" / "locked.py"), str(lock)]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, encoding="utf-8"
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("missing Python packages: not-there==1.0; ")
    assert "PIP_FIND_LINKS=FOLDER" in done.stderr


def set_up_place(folder):
    """Make a folder with the set-up, in which all that it installs seems to be there."""
    installed = ("requirements.lock", "pyproject.toml")
    for file in (*installed, "scripts/setup"):
        (folder / file).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / file, folder / file)
    programs = folder / ".venv" / "bin"
    programs.mkdir(parents=True)
    (programs / "python").symlink_to(sys.executable)
    sums = [f"{sha256((folder / file).read_bytes()).hexdigest()}  {file}" for file in installed]
    stamp = "\n".join([f"made in {folder}", *sums, ""])
    (folder / ".venv" / ".stamp").write_text(stamp, encoding="utf-8")


@pytest.mark.parametrize("name", ["clone", "Jörg's (1) & co #2"])
def test_packages_are_installed_in_a_clone_of_any_path(tmp_path, name):
    """Pip's words arrive as they are, each on a line."""
    folder = tmp_path / name
    folder.mkdir()
    set_up_place(folder)
    stamp = folder / ".venv" / ".stamp"
    stamp.write_text(f"made in {folder}\n", encoding="utf-8")
    uv = folder / ".venv" / "bin" / "uv"
    uv.write_text("#!/bin/sh\n", encoding="utf-8")
    uv.chmod(0o755)
    (folder / "tools").mkdir()
    (folder / "tools" / "locked.py").write_text(
        "import os, pathlib\n"
        "pathlib.Path('words').write_text(os.environ['COINCID_PIP'], encoding='utf-8')\n",
        encoding="utf-8",
    )
    subprocess.run([folder / "scripts" / "setup"], check=True, capture_output=True)
    words = (folder / "words").read_text(encoding="utf-8").splitlines()
    program = str(folder / ".venv" / "bin" / "python")
    assert words in (
        [program, "-m", "pip"],
        [os.environ.get("PYTHON", "python3"), "-m", "pip", "--python", program],
    )


def test_another_python_is_made_until_it_has_its_packages(tmp_path):
    """The first installation fails, so the second call tries again."""
    set_up_place(tmp_path)
    uv = tmp_path / ".venv" / "bin" / "uv"
    uv.write_text(
        '#!/bin/sh\ncase "$*" in *"pip install"*) exit 7 ;; esac\nmkdir -p build/python3.12\n',
        encoding="utf-8",
    )
    uv.chmod(0o755)
    command = [tmp_path / "scripts" / "setup", "python3.12"]
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
        assert done.returncode == 7, done.stderr
    assert (tmp_path / "build" / "python3.12").is_dir()


@pytest.mark.parametrize(
    ("python", "code", "says"),
    [
        (sys.executable, 0, ""),
        ("/nonexistent", 1, "PYTHON=/nonexistent: does not run"),
        ("./other", 1, "PYTHON=./other: is Python 3.99, and .venv has"),
    ],
)
def test_another_python_than_that_of_the_environment_is_refused(tmp_path, python, code, says):
    """The environment stays, because it may have what somebody has put into it."""
    set_up_place(tmp_path)
    other = tmp_path / "other"
    other.write_text("#!/bin/sh\necho 3.99\n", encoding="utf-8")
    other.chmod(0o755)
    done = subprocess.run(
        [tmp_path / "scripts" / "setup"],
        env=os.environ | {"PYTHON": python},
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert done.returncode == code
    assert says in done.stderr


NOTED = """import os, sys
from pathlib import Path
assert not {"PYTHONPATH", "VIRTUAL_ENV"} & set(os.environ), "of the caller"
with open("noted", "a", encoding="utf-8") as file:
    file.write(" ".join([Path(__file__).name, *sys.argv[1:]]) + "\\n")
sys.exit(os.environ.get("FAILING") == Path(__file__).name)
"""
BASIC = "bash cat dirname find flock grep kill rm sed sha256sum sleep sort tr wc".split()


@pytest.fixture
def place(tmp_path):
    """Return a folder in which the set-up notes what it installs: lock files, by `locked.py`, and
    system packages, by `system.py`. It has all Python packages but none of the system.
    """
    folder = tmp_path / "clone"
    folder.mkdir()
    set_up_place(folder)
    (folder / "tools").mkdir()
    for name in ("locked.py", "system.py"):
        (folder / "tools" / name).write_text(NOTED, encoding="utf-8")
    programs = tmp_path / "programs"
    programs.mkdir()
    for name in BASIC:
        (programs / name).symlink_to(shutil.which(name))
    (programs / "python3").symlink_to(sys.executable)
    uv = folder / ".venv" / "bin" / "uv"
    uv.write_text('#!/bin/sh\necho "uv $*" >>noted\n', encoding="utf-8")
    uv.chmod(0o755)
    return folder


def set_up(place, *needs, **environment):
    """Run the set-up; return its exit code, what it says, and what it has installed. The caller has
    an environment and a search path of its own.
    """
    noted = place / "noted"
    noted.unlink(missing_ok=True)
    done = subprocess.run(
        [place / "scripts" / "setup", *needs],
        cwd=place.parent,
        env={"PATH": str(place.parent / "programs"), "VIRTUAL_ENV": "/a", "PYTHONPATH": "/b"}
        | environment,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    installed = noted.read_text(encoding="utf-8").splitlines() if noted.exists() else []
    return done.returncode, done.stderr, installed


def test_a_lock_is_installed_when_it_is_new_or_has_changed_and_only_then(place):
    """Not one that no need asks for, nor one whose installation has succeeded before."""
    assert set_up(place) == (0, "", [])
    for name in ("sweep", "explore", "board"):
        (place / f"requirements-{name}.lock").write_text("a==1\n", encoding="utf-8")
    assert set_up(place) == (0, "", [])
    failed, _, installed = set_up(place, "sweep", "explore", FAILING="locked.py")
    locks = "requirements-explore.lock requirements-sweep.lock"
    assert failed == 1 and installed == [f"locked.py {locks}"]
    assert set_up(place, "sweep", "explore")[2] == [f"locked.py {locks}"]
    for need in ("explore", "sweep"):
        assert set_up(place, need)[2] == []
    for name in ("requirements-sweep.lock", "requirements.lock", "pyproject.toml"):
        with (place / name).open("a", encoding="utf-8") as file:
            file.write("# changed\n")
    locked, editable = set_up(place, "explore")[2]
    assert locked == "locked.py requirements.lock"
    assert editable.startswith("uv ") and editable.endswith(" --no-build-isolation --editable .")
    assert set_up(place, "sweep")[2] == ["locked.py requirements-sweep.lock"]
    assert set_up(place) == (0, "", [])
    (place / "requirements-sweep.lock").write_text("a==1\n", encoding="utf-8")  # as it was before
    assert set_up(place, "sweep")[2] == ["locked.py requirements-sweep.lock"]


def test_of_two_set_ups_at_once_the_second_finds_the_work_done(place):
    """It waits for the first, which takes its time."""
    (place / "requirements-sweep.lock").write_text("a==1\n", encoding="utf-8")
    waits = "import time\nwhile not Path('go').exists():\n    time.sleep(0.01)\n"
    (place / "tools" / "locked.py").write_text(
        NOTED.replace("sys.exit(", f"{waits}sys.exit("), encoding="utf-8"
    )
    command = [place / "scripts" / "setup", "sweep"]
    environment = {"PATH": str(place.parent / "programs")}
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as first:
        while not (place / "noted").exists():
            assert first.poll() is None
            time.sleep(0.01)
        with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as second:
            time.sleep(0.2)
            (place / "go").touch()
            assert (first.wait(), second.wait()) == (0, 0)
    noted = (place / "noted").read_text(encoding="utf-8")
    assert noted == "locked.py requirements-sweep.lock\n"


@pytest.mark.parametrize("brought", [False, True])
def test_packages_come_by_uv_where_pip_can_bring_it(place, brought):
    """Otherwise the installer is told of none, and takes pip."""
    (place / "requirements-sweep.lock").write_text("a==1\n", encoding="utf-8")
    (place / "tools" / "locked.py").write_text(
        NOTED.replace("*sys.argv[1:]", "os.environ['COINCID_UV']"), encoding="utf-8"
    )
    uv = place / ".venv" / "bin" / "uv"
    uv.unlink()
    brings = f"Path({str(uv)!r}).touch(0o755)" if brought else "sys.exit(3)"
    (place / "pip.py").write_text(
        "import sys\nfrom pathlib import Path\nif __name__ == '__main__':\n"
        f"    Path('pip').write_text(' '.join(sys.argv), encoding='utf-8')\n    {brings}\n",
        encoding="utf-8",
    )
    assert set_up(place, "sweep")[2] == [f"locked.py {uv if brought else ''}"]
    assert (place / "pip").read_text(encoding="utf-8").endswith(" -r requirements-uv.lock")


@pytest.mark.parametrize(
    ("need", "missing", "packages"),
    [
        ("rtl", "g++", "g++"),
        ("icarus", "iverilog", "iverilog"),
        ("verilator", "verilator", "verilator"),
        ("cells", "sta", "opensta"),
        ("chromium", "chromium-headless-shell", "chromium-headless-shell"),
    ],
)
def test_a_system_package_is_installed_where_its_program_is_missing(place, need, missing, packages):
    """Only for its need, and without it the set-up fails, except where it is the optional browser."""
    assert set_up(place, "explore") == (0, "", [])
    there = place.parent / "programs"
    for name in {"g++", missing}:
        (there / name).symlink_to(shutil.which("true"))
    assert set_up(place, need) == (0, "", [])
    (there / missing).unlink()
    assert set_up(place, need) == (0, "", [f"system.py {packages}"])
    code, _, installed = set_up(place, need, FAILING="system.py")
    assert installed == [f"system.py {packages}"]
    assert code == (need != "chromium")


@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize(
    ("need", "module", "says", "package"),
    [
        ("rtl", "find_libpython", "print('libpython.so')", f"libpython3.{sys.version_info.minor}"),
        ("raytrace", "coincid.model.scenes.ray_scene", "def llvm_library(): pass", "libllvm19"),
    ],
)
def test_a_system_library_is_installed_where_python_does_not_find_it(
    place, need, module, says, package, there
):
    """When the Python packages of its need are new."""
    (place.parent / "programs" / "g++").symlink_to(shutil.which("true"))
    (place / f"requirements-{need}.lock").write_text("a==1\n", encoding="utf-8")
    file = place.joinpath(*module.split(".")).with_suffix(".py")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"{says if there else ''}\n", encoding="utf-8")
    code, _, installed = set_up(place, need)
    packages = [] if there else [f"system.py {package}"]
    assert (code, installed) == (0, [f"locked.py requirements-{need}.lock", *packages])


def test_another_python_has_the_packages_of_the_lock_and_the_project(place):
    """Once; and again when the lock has changed."""
    for name in ("cmp", "cp", "mkdir", "tail"):
        (place.parent / "programs" / name).symlink_to(shutil.which(name))
    uv = place / ".venv" / "bin" / "uv"
    uv.write_text(f"{uv.read_text(encoding='utf-8')}mkdir -p build/python3.12\n", encoding="utf-8")
    code, said, (made, locks, project) = set_up(place, "python3.12")
    assert code == 0, said
    assert made.startswith("uv venv ") and made.endswith(" build/python3.12")
    assert "--python build/python3.12/bin/python " in locks
    assert "--python build/python3.12/bin/python " in project
    assert locks.endswith(" --no-deps -r requirements.lock")
    assert project.endswith(" --no-build-isolation --editable .")
    assert set_up(place, "python3.12") == (0, "", [])
    with (place / "requirements.lock").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert made in set_up(place, "python3.12")[2]


@pytest.mark.parametrize("beside", [[], ["3.11.2"], ["3.12.1", "3.12.4", "3.13.0"]])
def test_another_python_is_one_that_lies_beside_ours_or_that_uv_finds(place, beside):
    """Pyenv and uv put all versions into one folder; of several that fit, the last one counts."""
    versions = place.parent / "versions"
    for name in ["3.11.9", *beside]:
        program = versions / name / "bin" / f"python{name.rpartition('.')[0]}"
        program.parent.mkdir(parents=True)
        program.touch()
    ours = f"    *base_prefix*) echo {versions / '3.11.9'} ;;\n"
    another_python(place.parent, (3, 11, 9), ours)
    for name in ("cmp", "cp", "tail"):
        (place.parent / "programs" / name).symlink_to(shutil.which(name))
    uv = place / ".venv" / "bin" / "uv"
    uv.write_text(f"{uv.read_text(encoding='utf-8')}mkdir -p build/python3.12\n", encoding="utf-8")
    code, said, (made, *_) = set_up(place, "python3.12")
    assert code == 0, said
    (named,) = re.findall(r"--python (\S+) ", made)
    if beside[1:]:
        assert Path(named).resolve() == versions / "3.12.4" / "bin" / "python3.12"
    else:
        assert named == "3.12"


def test_an_interrupted_installation_ends_and_counts_as_none(place):
    """The installer ends, too; the next call installs."""
    (place / "requirements-sweep.lock").write_text("a==1\n", encoding="utf-8")
    waits = "import time\nprint('begins', flush=True)\ntime.sleep(20)\nprint('goes on')\n"
    (place / "tools" / "locked.py").write_text(waits, encoding="utf-8")
    process = subprocess.Popen(
        [place / "scripts" / "setup", "sweep"],
        env={"PATH": str(place.parent / "programs")},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        encoding="utf-8",
    )
    with process:
        assert process.stdout.readline() == "begins\n"
        process.terminate()
        assert process.wait() == 130
        assert process.stdout.read() == ""
    (place / "tools" / "locked.py").write_text(NOTED, encoding="utf-8")
    assert set_up(place, "sweep")[2] == ["locked.py requirements-sweep.lock"]


def test_a_project_that_cannot_be_installed_is_told_with_its_reason(place):
    """Without uv, by the words of pip; it does not count as installed."""
    (place / ".venv" / "bin" / "uv").unlink()
    fails = "import sys\nprint('pip', *sys.argv[1:], file=sys.stderr)\nsys.exit(3)\n"
    (place / "pip.py").write_text(fails, encoding="utf-8")
    with (place / "pyproject.toml").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    for _ in range(2):
        code, said, _ = set_up(place)
        assert code == 1
        (line,) = said.splitlines()
        assert line.startswith("pip ") and line.endswith(" --no-build-isolation --editable .")
        assert {"install", "--no-deps"} <= {*line.split()}


MADE = """#!/bin/sh
case "$*" in
{first}    *sys.exit*) exec {python} -c "import sys; sys.version_info = {version}; $2" ;;
    -V) echo Python 3.10.9 ;;
    *"-m venv"*) echo "$*" >>noted; rm -rf .venv/bin; mkdir -p .venv/bin; ln -s "$0" .venv/bin/python ;;
    *locked.py*) exit 0 ;;
esac
"""


def another_python(folder, version, first=""):
    """Make a Python of another version the machine's `python3`. first: cases of its shell script
    before those of all.
    """
    other, programs = folder / "other", folder / "programs"
    text = MADE.format(python=shlex.quote(sys.executable), version=version, first=first)
    other.write_text(text, encoding="utf-8")
    other.chmod(0o755)
    (programs / "python3").unlink()
    (programs / "python3").symlink_to(other)
    for name in ("ln", "mkdir"):
        (programs / name).symlink_to(shutil.which(name))


@pytest.mark.parametrize("moved", [False, True])
def test_an_environment_is_made_anew_in_a_folder_that_was_moved(place, moved):
    """What is behind a link stays: it belongs to somebody else."""
    another_python(place.parent, (3, 11, 0))
    if moved:
        place = place.rename(place.with_name("elsewhere"))
    else:
        (place / ".venv").rename(place.parent / "theirs")
        (place / ".venv").symlink_to(place.parent / "theirs")
        (place.parent / "theirs" / ".stamp").unlink()
    code, said, installed = set_up(place)
    assert code == 0, said
    assert installed[0] == "-m venv --clear --without-pip .venv"
    assert not (place / ".venv").is_symlink()
    assert f"made in {place}" in (place / ".venv" / ".stamp").read_text(encoding="utf-8")
    if not moved:
        assert (place.parent / "theirs" / "bin" / "uv").exists()
    assert set_up(place) == (0, "", [])


@pytest.mark.parametrize("ensured", [False, True])
def test_an_environment_of_a_python_without_pip_gets_its_own(place, ensured):
    """Debian has what makes one in a package of its own, by the version of Python."""
    own = f"""    *"pip --version"*) exit 1 ;;
    *ensurepip*) exit {0 if ensured else 1} ;;
    *version_info.minor*) echo 13 ;;
    *system.py*) echo "$*" >>noted ;;
"""
    another_python(place.parent, (3, 13, 0), own)
    (place / ".venv" / ".stamp").unlink()
    code, said, installed = set_up(place)
    assert code == 0, said
    packages = [] if ensured else ["tools/system.py python3.13-venv"]
    assert installed[: len(packages) + 1] == [*packages, "-m venv --clear .venv"]


def test_an_old_python_is_refused_by_its_version(place):
    another_python(place.parent, (3, 10, 9))
    (place / ".venv").rename(place / "gone")
    code, said, installed = set_up(place)
    assert (code, installed) == (1, [])
    assert said == "Python 3.10.9: 3.11 or newer is needed; name one with PYTHON=...\n"


def test_types_are_checked_in_all_packages_from_any_folder(tmp_path):
    """With the options that are given; the exit code is that of the check."""
    place = tmp_path / "a clone"
    for folder in ("scripts", ".venv/bin"):
        (place / folder).mkdir(parents=True)
    shutil.copy(ROOT / "scripts" / "types", place / "scripts")
    program = place / ".venv" / "bin" / "mypy"
    program.write_text('#!/bin/sh\necho "$MYPYPATH: $*"\npwd\nexit 3\n', encoding="utf-8")
    program.chmod(0o755)
    done = subprocess.run(
        [place / "scripts" / "types", "--strict"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    asked = "src: --package coincid --package docs.studies --strict"
    assert (done.returncode, done.stdout.splitlines()) == (3, [asked, str(place)])


def test_an_unknown_need_is_refused():
    done = subprocess.run(
        [ROOT / "scripts" / "setup", "nothing"], capture_output=True, text=True, encoding="utf-8"
    )
    assert done.returncode == 2
    assert "known: rtl, explore" in done.stderr

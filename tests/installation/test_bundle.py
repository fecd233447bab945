"""What is packed for a machine without a network, what `install.sh` refuses, and the wheel on each declared Python."""

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from importlib.metadata import version
from pathlib import Path

import bundle
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "installation/install.sh"
FACTS = {"version": "1.2.3", "python": bundle.PYTHON, "platform": "linux", "machine": platform.machine()}
FACTS |= {"glibc": "2.17", "megabytes": "1"}


def test_the_packages_are_those_of_product_and_client_and_of_all_that_they_need():
    packed = bundle.pinned(ROOT)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    of_the_product = {canonicalize_name(Requirement(text).name) for text in project["dependencies"]}
    # What they need themselves, the driver of the extra, and what the client needs.
    template = (ROOT / "openapi/clients/templates/pyproject.toml.jinja").read_text()
    of_the_client = {Requirement(text).name for text in tomllib.loads(template)["project"]["dependencies"]}
    needed = of_the_product - {"tbb"} | {"llvmlite", "starlette", "psycopg-binary"} | of_the_client
    assert needed <= packed.keys()
    assert {line.split()[0] for line in bundle.hashed(ROOT).values()} == {"==".join(item) for item in packed.items()}
    of_tests = {canonicalize_name(Requirement(text).name) for text in project["optional-dependencies"]["dev"]}
    assert packed.keys() & of_tests <= of_the_product | {"packaging"}  # which a package of the product needs too
    # Needed before Python 3.11.3, whatever this one is.
    assert packed.pop("async-timeout")
    # Nothing is left that an installed one needs: the tests run with the same versions.
    assert {name: Version(version(name)) for name in packed} == {name: Version(packed[name]) for name in packed}
    needed = {canonicalize_name(each.name) for name in packed for each in bundle.needs_of(name, ()) if not each.marker}
    assert needed <= packed.keys()


def test_a_package_without_a_pin_and_a_wheel_of_another_digest_are_refused(tmp_path):
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    pins = (ROOT / "constraints.txt").read_text()
    (tmp_path / "constraints.txt").write_text(re.sub(r"^llvmlite==.*\n", "", pins, flags=re.MULTILINE))
    with pytest.raises(bundle.BundleError, match=r"llvmlite is not in constraints\.txt: pin it there"):
        bundle.pinned(tmp_path)
    (tmp_path / "attrs-1.0-py3-none-any.whl").write_bytes(b"another")
    with pytest.raises(bundle.BundleError, match=r"attrs-1\.0-py3-none-any\.whl is not a wheel of installation/hashes"):
        bundle.check(tmp_path, bundle.hashed(ROOT))


def test_an_archive_depends_on_its_content_alone(tmp_path):
    digests = []
    for number, mask in enumerate((0o022, 0o077)):
        content = tmp_path / f"content-{number}"
        before = os.umask(mask)
        (content / "docs").mkdir(parents=True)
        os.umask(before)
        for name in ("docs/page.txt", "install.sh"):
            (content / name).write_text(name)
            os.utime(content / name, (number, number))
        archive = tmp_path / f"{number}.tar.gz"
        bundle.pack(content, "sawmill", archive, 1_700_000_000)
        digests.append(bundle.digest(archive))
    assert digests[0] == digests[1]
    with tarfile.open(archive) as tar:
        modes = {entry.name: (entry.mode, entry.uid) for entry in tar}
    assert modes == {"sawmill/docs": (0o755, 0), "sawmill/docs/page.txt": (0o644, 0), "sawmill/install.sh": (0o755, 0)}


@pytest.mark.parametrize(
    ("tags", "least"),
    [
        ("py3-none-any", (2, 17)),
        ("cp311-cp311-manylinux_2_27_x86_64.manylinux_2_28_x86_64", (2, 27)),
        ("cp311-cp311-manylinux1_x86_64.manylinux_2_28_x86_64", (2, 5)),
    ],
)
def test_the_c_library_that_a_wheel_needs_is_the_oldest_of_its_tags(tags, least):
    assert bundle.least_glibc(Path(f"a-1.0-{tags}.whl")) == least


@pytest.fixture
def unpacked(tmp_path):
    """A bundle with one wheel, as it lies on the machine."""
    folder = tmp_path / "the bundle"
    (folder / "wheels").mkdir(parents=True)
    (folder / "wheels/a-1.0-py3-none-any.whl").write_bytes(b"a wheel")
    (folder / "install.sh").write_bytes(SCRIPT.read_bytes())
    describe(folder)
    return folder


def describe(folder, **changes):
    (folder / "BUNDLE").write_text("".join(f"{name}={value}\n" for name, value in (FACTS | changes).items()))
    (folder / "SHA256SUMS").unlink(missing_ok=True)
    (folder / "SHA256SUMS").write_text("".join(bundle.sums(folder)))


def install(unpacked, *arguments):
    command = ["sh", str(unpacked / "install.sh"), *map(str, arguments)]
    return subprocess.run(command, cwd=unpacked.parent, capture_output=True, text=True, check=False)


@pytest.fixture
def refused(unpacked, tmp_path):
    def run(*arguments, code=1):
        done = install(unpacked, *arguments)
        assert (done.returncode, done.stdout) == (code, ""), done.stderr
        assert not (tmp_path / "target/current").exists()
        return done.stderr

    return run


def test_a_damaged_or_missing_file_is_named(refused, unpacked, tmp_path):
    wheel = unpacked / "wheels/a-1.0-py3-none-any.whl"
    wheel.write_bytes(b"a whale")
    assert f"{wheel.relative_to(unpacked)}: FAILED" in refused("--python", sys.executable, tmp_path / "target")
    wheel.unlink()
    complaint = refused("--python", sys.executable, tmp_path / "target")
    assert "the bundle is damaged" in complaint
    assert str(wheel.relative_to(unpacked)) in complaint


def test_another_python_is_refused_by_its_version(refused, tmp_path):
    other = tmp_path / "python"
    other.write_text("#!/bin/sh\necho 3.9\n")
    other.chmod(0o755)
    assert f"needs Python {bundle.PYTHON}, and {other} is Python 3.9" in refused("--python", other, tmp_path / "target")
    assert "there is no no-python" in refused("--python", "no-python", tmp_path / "target")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"megabytes": "999999999"}, "and the installation needs 999999999 MB"),
        ({"machine": "sparc"}, f"this bundle is for sparc, and this machine is {platform.machine()}"),
        ({"glibc": "9.1"}, "needs glibc 9.1 or later"),
    ],
    ids=["no room", "machine", "glibc"],
)
def test_a_machine_that_cannot_run_it_is_refused(refused, unpacked, tmp_path, changes, complaint):
    describe(unpacked, **changes)
    assert complaint in refused("--python", sys.executable, tmp_path / "target")
    assert not (tmp_path / "target").exists()


def test_a_version_that_is_installed_stays_as_it_is(refused, tmp_path):
    (tmp_path / "target/1.2.3").mkdir(parents=True)
    assert f"{tmp_path / 'target/1.2.3'} is there already" in refused("--python", sys.executable, "target")
    assert list((tmp_path / "target").iterdir()) == [tmp_path / "target/1.2.3"]


def test_an_installation_that_fails_leaves_nothing_of_itself(unpacked, tmp_path):
    # The one wheel is none: pip refuses it. What an interrupted installation left is no hindrance.
    (tmp_path / "target/1.2.3").mkdir(parents=True)
    (tmp_path / "target/1.2.3/unfinished").touch()
    fake = tmp_path / "python"
    fake.write_text(f'#!/bin/sh\n[ "$3" != venv ] || exit 7\nexec {sys.executable} "$@"\n')
    fake.chmod(0o755)
    done = install(unpacked, "--python", fake, tmp_path / "target")
    assert (done.returncode, list((tmp_path / "target").iterdir())) == (7, []), done.stderr


# A Python of which only the checks are real: what it makes is there at once and does nothing.
STAND_IN = """\
#!/bin/sh
if [ "$2 $3" != "-m venv" ]; then exec {python} "$@"; fi
mkdir "$4/bin"
printf '#!/bin/sh\\necho "$0" "$@" >> {log}\\n' > "$4/bin/python"
cp "$4/bin/python" "$4/bin/sawmill"
chmod 755 "$4/bin/python" "$4/bin/sawmill"
"""


def test_versions_lie_beside_each_other_and_a_link_leads_to_the_one_in_use(unpacked, tmp_path):
    target, log, stand_in = tmp_path / "in use", tmp_path / "log", tmp_path / "python"
    stand_in.write_text(STAND_IN.format(python=sys.executable, log=log))
    stand_in.chmod(0o755)
    pages = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "LICENSE")
    for name in (*pages, "LICENSES.txt", "sbom.cdx.json", "docker-compose.yml"):
        (unpacked / name).touch()
    for name in ("docs", "examples", "openapi"):
        (unpacked / name).mkdir()

    def installed():
        done = install(unpacked, "--python", stand_in, target)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    describe(unpacked)
    assert f'"{target}/current/bin/sawmill" install-service --to /etc/systemd/system' in installed()
    given = log.read_text().splitlines()
    assert "install --quiet --no-index --no-deps --no-cache-dir wheels/a-1.0-py3-none-any.whl" in given[0]
    assert given[1:] == [
        f"{target}/1.2.3/bin/python -I -m pip --isolated --disable-pip-version-check check",
        f"{target}/1.2.3/bin/sawmill compile",
    ]
    describe(unpacked, version="1.3.0")
    shown = installed()
    assert (target / "current").readlink() == Path("1.2.3")
    (change,) = re.findall(r"^  (ln .*)$", shown, re.MULTILINE)
    for version_in_use in ("1.3.0", "1.2.3"):
        subprocess.run(["sh", "-c", change.replace("1.3.0", version_in_use)], check=True)
        assert (target / "current").readlink() == Path(version_in_use)
    shared = sorted(path.name for path in (target / "1.3.0/share/sawmill").iterdir())
    assert shared[:3] == ["CHANGELOG.md", "CONTRIBUTING.md", "LICENSE"]


@pytest.mark.parametrize("arguments", [(), ("--fast", "/opt"), ("/opt", "/srv"), ("--python",)])
def test_wrong_use_is_answered_with_the_usage(refused, arguments):
    assert "usage: sh install.sh [--python PROGRAM] FOLDER" in refused(*arguments, code=2)


CLASSIFIERS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
DECLARED = re.findall(r"Python :: (3\.\d+)", "\n".join(CLASSIFIERS))
SCAN = ("simulate", "l-shape", "--theta", "146.1deg,714.7,319.9,43.7,15.7deg", "--views", "20", "--noise", "0.02")


def interpreter(wanted):
    """A Python of this version: on the path, or one that pyenv has."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    candidates = [shutil.which(f"python{wanted}"), *sorted(pyenv.glob(f"{wanted}.*/bin/python{wanted}"))]
    for candidate in filter(None, candidates):
        asked = [str(candidate), "-c", "import ensurepip, sys; print('%d.%d' % sys.version_info[:2])"]
        found = subprocess.run(asked, capture_output=True, text=True, check=False)
        if (found.returncode, found.stdout.strip()) == (0, wanted):
            return str(candidate)
    return None


def run(*command, folder):
    clean = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    words = [str(part) for part in command]
    done = subprocess.run(words, cwd=folder, env=clean, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    bundle.export(ROOT, folder / "sources")
    build = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder)
    run(sys.executable, *build, folder / "sources", folder=folder)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scan")
    run(Path(sys.executable).with_name("sawmill"), *SCAN, "--output", "scan.h5", folder=folder)
    return folder / "scan.h5"


def theta(sawmill, scan):
    constants = ("--data", "counts", "--source-to-cor-mm", "859.46", "--phantom", "l-shape")
    return json.loads(run(sawmill, "calibrate", scan, *constants, "--json", folder=scan.parent))["theta"]


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("declared", DECLARED)
def test_the_wheel_gives_the_same_theta_on_each_declared_python(declared, wheel, scan, tmp_path):
    python = interpreter(declared)
    if python is None:
        pytest.skip(f"there is no Python {declared} with ensurepip here")
    run(python, "-m", "venv", tmp_path / "environment", folder=tmp_path)
    programs = tmp_path / "environment/bin"
    pip = (programs / "python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet")
    run(*pip, "--constraint", ROOT / "constraints.txt", wheel, folder=tmp_path)
    # Kernels that are compiled in another order may differ in the last digit.
    run(programs / "sawmill", "compile", folder=tmp_path)
    assert theta(programs / "sawmill", scan) == theta(Path(sys.executable).with_name("sawmill"), scan)

"""Documents about all packages that are shipped, from their wheels: a bill of materials, and the licences."""

import zipfile
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from email.message import Message
from email.parser import BytesParser
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.license import DisjunctiveLicense
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

# Names of files with the text of a licence, or with notices that it asks to keep; programs may be named so, too.
_TEXTS = ("licen", "copying", "notice", "authors", "third-party")
_NO_TEXTS = {".py", ".pyi"}
_RULE = "=" * 100
# Files of others inside a wheel whose own licence the wheel does not contain: the licence is that of their project.
_INSIDE = {
    "fastapi_offline": "It contains swagger-ui-bundle.js and swagger-ui.css (Swagger UI, Apache-2.0, whose text stands "
    "above all packages here) and redoc.standalone.js (Redoc, MIT)."
}


def bill_of_materials(wheels: Sequence[Path], digests: dict[str, str], committed_at: int) -> str:
    """Write the wheels as a CycloneDX 1.6 document in JSON; the same wheels and time give the same bytes.

    Parameters
    ----------
    wheels
        All wheels, that of the product among them.
    digests
        SHA-256 of each wheel, hexadecimal, by file name.
    committed_at
        Time of the commit, seconds since 1970.
    """
    components = [_component(wheel, digests[wheel.name]) for wheel in wheels]
    (product,) = (component for component in components if component.name == "sawmill-calibration")
    bom = Bom(components=[component for component in components if component is not product])
    product.type = ComponentType.APPLICATION
    bom.metadata.component = product
    bom.metadata.timestamp = datetime.fromtimestamp(committed_at, UTC)
    bom.serial_number = uuid5(NAMESPACE_URL, "\n".join(f"{name} {digests[name]}" for name in sorted(digests)))
    bom.register_dependency(product, bom.components)
    return JsonV1Dot6(bom).output_as_string(indent=2) + "\n"


def _component(wheel: Path, digest: str) -> Component:
    about = metadata(wheel)
    name, version = str(about["Name"]), str(about["Version"])
    return Component(
        name=name,
        version=version,
        type=ComponentType.LIBRARY,
        purl=PackageURL("pypi", None, name.lower().replace("_", "-"), version),
        bom_ref=f"{name}=={version}",
        licenses=[DisjunctiveLicense(name=licence(about))],
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
    )


def licences(wheels: Sequence[Path], own: str) -> Iterator[str]:
    """Yield the lines of one document with the licence of each package and its texts, our own first.

    Parameters
    ----------
    own
        Text of the product's licence.
    """
    yield f"Sawmill calibration is licensed under Apache-2.0:\n\n{own}\n"
    yield "It is shipped with these packages. Debian's packages in the image have theirs in /usr/share/doc.\n\n"
    foreign = [(wheel, metadata(wheel)) for wheel in wheels if not wheel.name.startswith("sawmill_calibration")]
    yield from (f"{about['Name']} {about['Version']}: {licence(about)}\n" for _, about in foreign)
    for wheel, about in foreign:
        yield f"\n{_RULE}\n{about['Name']} {about['Version']}: {licence(about)}\n"
        yield f"{_INSIDE[about['Name']]}\n" if about["Name"] in _INSIDE else ""
        texts = list(_texts(wheel))
        yield from (f"\n----- {name}\n\n{text}\n" for name, text in texts)
        yield "" if texts else "\nIts wheel contains no text of the licence.\n"


def _texts(wheel: Path) -> Iterator[tuple[str, str]]:
    """Yield the files with licences in a wheel."""
    with zipfile.ZipFile(wheel) as packed:
        for name in sorted(packed.namelist()):
            path = Path(name)
            licensing = path.name.lower().startswith(_TEXTS) or "licenses" in path.parts[:-1]
            if licensing and path.suffix not in _NO_TEXTS and not name.endswith("/"):
                yield name, packed.read(name).decode(errors="replace").strip()


def metadata(wheel: Path) -> Message:
    """Read the package's metadata from a wheel."""
    with zipfile.ZipFile(wheel) as packed:
        (name,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA") and name.count("/") == 1)
        return BytesParser().parsebytes(packed.read(name))


def licence(about: Message) -> str:
    """Return the licence as the package's makers state it: an expression, a name, or a classifier."""
    given = [about["License-Expression"], about["License"]]
    given += [text.rpartition(" :: ")[2] for text in about.get_all("Classifier", []) if text.startswith("License ::")]
    # Some packages have the whole text of the licence there; a text that is not ASCII is no `str`.
    lines = [line for line in (str(text).strip() for text in given if text) if "\n" not in line and line != "UNKNOWN"]
    return lines[0] if lines else "see the wheel"

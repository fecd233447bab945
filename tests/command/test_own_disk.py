"""What the command line reads from one's own disk and the service does not: fields apart, linked HDF5, folders."""

import json

import h5py
import numpy as np
import pytest
import tifffile

THETA = "2.55,714.7,319.9,43.7,0.281"
PITCH = ("--detector-pitch-mm", 4.508593749)
GEOMETRY = ("--source-to-cor-mm", 859.46, "--theta", THETA, "--size", 32, "--rows", "2:3")


@pytest.fixture(scope="session")
def parts(scans, stack):
    """Views, flats and darks of the stack, each in a file of its own, and its flags for the angles."""
    with h5py.File(stack) as file:
        detector = file["entry/instrument/detector"]
        images, keys = detector["data"][()], detector["image_key"][()]
        angles = file["entry/sample/rotation_angle"][()][keys == 0]
    for name, key in (("views", 0), ("flats", 1), ("darks", 2)):
        np.save(scans / f"{name}.npy", images[keys == key])
    (scans / "angles.txt").write_text("\n".join(f"{angle:.12g}" for angle in angles))
    return scans


def test_counts_without_flats_name_the_flag(failure, parts, tmp_path):
    given = (*GEOMETRY, "--data", "counts", "-o", tmp_path / "out.h5", "--angles-file", parts / "angles.txt")
    answer = failure("reconstruct", parts / "views.npy", *given, *PITCH)
    assert answer["code"] == "flats-missing"
    assert "(--flats)" in answer["detail"]


def test_flats_that_do_not_exist_are_wrong_use(wrong_use, stack):
    flags = ("--data", "counts", *GEOMETRY, "-o", "out.h5")
    assert "'--flats'" in wrong_use("reconstruct", stack, *flags, "--flats", "nowhere.tif")


def test_fields_in_both_places_are_refused(failure, parts, stack, tmp_path):
    given = ("--data", "counts", *GEOMETRY, "-o", tmp_path / "out.h5", "--flats", parts / "flats.npy")
    answer = failure("reconstruct", stack, *given)
    assert answer["code"] == "contradiction"
    assert json.dumps(answer).count("--flats") == 1


@pytest.fixture(scope="session")
def master(scans, stack):
    """An NXtomo file whose images and angles lie in another one."""
    with h5py.File(scans / "master.h5", "w") as file:
        for name in ("definition", "instrument", "sample"):
            file[f"entry/{name}"] = h5py.ExternalLink(stack.name, f"/entry/{name}")
    return scans / "master.h5"


def test_without_the_flag_the_refusal_names_it(failure, run, master, tmp_path):
    answer = failure("reconstruct", master, *GEOMETRY, "--data", "counts", "-o", tmp_path / "out.h5")
    assert answer["code"] == "external-storage"
    assert answer["detail"].endswith("--follow-links")
    inspected = json.loads(run("inspect", master, "--data", "counts", "--json").stdout)
    assert inspected["verdict"] == "incomplete"
    assert [part["flag"] for part in inspected["missing"]] == ["--follow-links"]


def test_inspect_follows_links_and_names_what_is_not_there(run, master, stack, tmp_path):
    answer = json.loads(run("inspect", master, "--data", "counts", "--follow-links", "--json").stdout)
    assert answer["verdict"] == "ready"
    assert answer["reading"]["other_files"] == [str(stack)]
    alone = tmp_path / "alone.h5"
    alone.write_bytes(master.read_bytes())
    answer = json.loads(run("inspect", alone, "--follow-links", "--json").stdout)
    assert answer["refusal"]["code"] == "linked-file-missing"
    assert stack.name in answer["refusal"]["detail"]
    assert {part["leads_to"] for part in answer["parts"]} >= {f"file {stack.name}:/entry/sample (not there)"}


@pytest.fixture(scope="session")
def folder(parts):
    """The same as a folder of images for the views, one for the flats, and a file of the darks."""
    for name in ("views", "flats"):
        (parts / name).mkdir()
        for index, image in enumerate(np.load(parts / f"{name}.npy")):
            tifffile.imwrite(parts / name / f"image-{index}.tif", image)
    return parts / "views"


def test_inspect_a_folder(run, folder):
    (folder / "notes.txt").write_text("nothing of the scan")
    answer = json.loads(run("inspect", folder, "--json", "--data", "counts").stdout)
    assert (answer["format"], answer["verdict"]) == ("folder-of-tiffs", "incomplete")
    images, notes = answer["parts"]
    assert (images["name"], images["count"]) == ("image-0.tif to image-59.tif", 60)
    assert (images["shape"], images["type"]) == ([4, 256], "uint16")
    assert (notes["name"], notes["type"]) == ("notes.txt", "txt")
    assert [part["flag"] for part in answer["missing"] if part["needed"]] == [
        "--angles-deg or --angles-file", "--flats", "--detector-pitch-mm",
    ]  # fmt: skip
    assert "1 files that are no TIFFs were ignored (notes.txt)." in answer["reading"]["remarks"]
    assert answer["size_bytes"] == sum(each.stat().st_size for each in folder.iterdir())

"""Do the whole job of a scanner's software with the generated client: `python whole_job.py ADDRESS SCAN.h5`.

docs/do/connect.md explains each step, and where the client comes from. `SAWMILL_KEY` is the key, where one is needed.
"""

import io
import json
import os
import sys
import time
import uuid
from pathlib import Path

import h5py
import httpx
import numpy as np
from sawmill_calibration_client import Client
from sawmill_calibration_client.api.calibrations import (
    activate_calibration,
    create_calibration,
    get_calibration,
    get_calibration_step,
    get_report,
)
from sawmill_calibration_client.api.drifts import create_drift, get_drift
from sawmill_calibration_client.api.reconstructions import create_reconstruction, get_reconstruction, get_slice
from sawmill_calibration_client.api.scanners import create_scanner
from sawmill_calibration_client.api.scans import upload_scan
from sawmill_calibration_client.api.uploads import create_upload, get_upload, send_part
from sawmill_calibration_client.models import (
    CalibrationRequest,
    DataKind,
    DriftRequest,
    Problem,
    ReconstructionRequest,
    ScannerConstants,
    ScannerRequest,
    UploadRequest,
    UploadState,
)
from sawmill_calibration_client.types import File

address, stack = sys.argv[1], Path(sys.argv[2])
key = os.environ.get("SAWMILL_KEY")
api = Client(
    base_url=address,
    headers={"Authorization": f"Bearer {key}"} if key else {},
    timeout=httpx.Timeout(60),  # a request may wait for a job
    raise_on_unexpected_status=True,
)


# Repeats and refusals
def again(operation, *arguments, **values):
    """Return the answer. Ask again while the connection fails or the service is busy; a refusal ends the program."""
    for pause_s in (1, 2, 4, 8, 0):
        try:
            answer = operation.sync(*arguments, client=api, **values)
        except httpx.TransportError as error:
            answer = error
        if isinstance(answer, Problem) and answer.status not in {429, 503}:
            raise SystemExit(f"{answer.code}: {answer.detail}")
        if not isinstance(answer, Problem | httpx.TransportError):
            return answer
        time.sleep(pause_s)
    raise SystemExit(f"{address} does not answer: {answer}")


def once(operation, **values):
    """Send a POST that makes one thing, however often it is repeated."""
    return again(operation, idempotency_key=str(uuid.uuid4()), **values)


# 1. Describe the scanner
constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.502864583)
scanner = once(create_scanner, body=ScannerRequest(name="Line 2", constants=constants))


# 2. Send the scan
def send(file, part_bytes=2**24):
    """Return the id of an upload that holds the whole file."""
    upload = once(create_upload, body=UploadRequest(size_bytes=file.stat().st_size, name=file.name))
    with file.open("rb") as stream:
        while upload.state is UploadState.RECEIVING:
            stream.seek(upload.offset_bytes)
            part = File(payload=io.BytesIO(stream.read(part_bytes)))
            try:
                answer = send_part.sync(upload.id, client=api, body=part, upload_offset=upload.offset_bytes)
            except httpx.TransportError:
                answer = None
            if answer is None or may_continue(answer):
                time.sleep(1)
                answer = again(get_upload, upload.id)  # has the offset at which to continue
            if isinstance(answer, Problem):
                raise SystemExit(f"{answer.code}: {answer.detail}")
            upload = answer
    return upload.id


def may_continue(answer):
    """Tell whether a refused part may be sent again, perhaps from another offset."""
    busy = {"wrong-offset", "upload-busy"}
    return isinstance(answer, Problem) and (answer.status in {429, 503} or answer.code in busy)


scan = once(
    upload_scan,
    upload_id=send(stack),
    scanner_id=scanner.id,
    data=DataKind.COUNTS,
    phantom_id="l-shape",
    phantom_rows="0:3",
)

# 3. Ask for a calibration
calibration = once(create_calibration, body=CalibrationRequest(scan_id=scan.id, activate=False))


# 4. Wait
def ended(operation, identifier):
    """Return the resource after its job has succeeded; a failure ends the program."""
    answer = again(operation, identifier, wait=30)
    while answer.state in {"queued", "running"}:
        answer = again(operation, identifier, wait=30)
    if answer.state != "succeeded":
        raise SystemExit(answer.failure.detail if answer.failure else f"{answer.id} {answer.state}")
    return answer


calibration = ended(get_calibration, calibration.id)

# 5. Read the verdict
step = again(get_calibration_step, calibration.id)
print(f"calibration: {calibration.verdict}, rays within {calibration.predicted_ray_error_mm.upper_95:.3f} mm")
print(f"next step: {step.headline}")
Path("report.png").write_bytes(again(get_report, calibration.id).payload.read())

# 6. Accept the calibration
once(activate_calibration, calibration_id=calibration.id)

# 7. Reconstruct the log
log = once(create_reconstruction, body=ReconstructionRequest(scan_id=scan.id, rows="3:6"))
log = ended(get_reconstruction, log.id)
Path("slice.png").write_bytes(again(get_slice, log.id, 0).payload.read())


def download(path, file):
    """Save a file of any size; continue an interrupted download where it ended."""
    tag = None
    with file.open("wb") as sink:
        for attempt in range(5):
            headers = {"Accept-Encoding": "identity"}
            if tag:
                headers |= {"Range": f"bytes={sink.tell()}-", "If-Range": tag}
            try:
                with api.get_httpx_client().stream("GET", path, headers=headers) as response:
                    response.raise_for_status()
                    if response.status_code == httpx.codes.OK:  # the whole file, not the rest of it
                        sink.seek(0)
                        sink.truncate()
                    tag = response.headers["ETag"]
                    for piece in response.iter_raw():
                        sink.write(piece)
                    return
            except httpx.TransportError:
                time.sleep(attempt)
    raise SystemExit(f"{path} was not received whole")


download(f"/v1/reconstructions/{log.id}/volume.h5", Path("volume.h5"))

# 8. Check a log for drift
with h5py.File(stack) as file:  # or the arrays as your software has them
    kinds = file["entry/instrument/detector/image_key"][:]
    images = file["entry/instrument/detector/data"][:, 3:6].astype(np.float32)
    angles_deg = file["entry/sample/rotation_angle"][:][kinds == 0]
counts, flat, dark = images[kinds == 0], images[kinds == 1].mean(axis=0), images[kinds == 2].mean(axis=0)
line_integrals = -np.log(np.maximum(counts - dark, 1) / (flat - dark))  # (views, rows, cells)
mean = io.BytesIO()
np.save(mean, line_integrals.mean(axis=1))
mean_scan = once(
    upload_scan,
    body=File(payload=mean.getvalue()),
    scanner_id=scanner.id,
    data=DataKind.LINE_INTEGRALS,
    averaged_rows=line_integrals.shape[1],
    angles_deg=",".join(map(str, angles_deg)),
)
drift = ended(get_drift, once(create_drift, body=DriftRequest(scan_id=mean_scan.id)).id)
print(f"drift: {drift.result.reason}")


# 9. Follow the events
def events(after=0):
    """Yield each event of the scanner; after a broken line, continue with the one after the last."""
    while True:
        query = {"scanner_id": scanner.id, "after": after}
        try:
            # The service sends something every five seconds: a longer silence is a broken line.
            with api.get_httpx_client().stream("GET", "/v1/events", params=query, timeout=15) as response:
                response.raise_for_status()
                for line in response.iter_lines():
                    event = json.loads(line.removeprefix("data: ")) if line.startswith("data: ") else {}
                    if "type" in event:
                        after = event["number"]
                        yield event
        except httpx.TransportError:
            pass
        time.sleep(1)


for event in events():
    print(event["number"], event["subject"], event["type"])
    if event["subject_id"] == drift.id and event["type"] == "succeeded":
        break

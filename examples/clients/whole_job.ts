// Do the whole job of a scanner's software in TypeScript 5, on Node 18 or later: whole_job ADDRESS SCAN.h5
// docs/do/connect.md explains each step. SAWMILL_KEY is the key, where one is needed.
//   npm install openapi-fetch openapi-typescript typescript@5 @types/node
//   npx openapi-typescript openapi.json --default-non-nullable=false --output contract.ts
//   npx tsc --strict --skipLibCheck --target es2022 --module nodenext --moduleResolution nodenext whole_job.ts
import { randomUUID } from "node:crypto";
import { open, writeFile } from "node:fs/promises";
import createClient from "openapi-fetch";
import type { components, paths } from "./contract.js";

type Schemas = components["schemas"];
type Answer<T> = { data?: T; error?: unknown; response: Response };

const [address, stack] = process.argv.slice(2);
if (!address || !stack) throw new Error("usage: whole_job ADDRESS SCAN.h5");
const key = process.env.SAWMILL_KEY;
const headers: Record<string, string> = key ? { Authorization: `Bearer ${key}` } : {};
const api = createClient<paths>({ baseUrl: address, headers });

// Repeats and refusals
const sleep = (seconds: number) => new Promise((done) => setTimeout(done, 1000 * seconds));

async function again<T>(send: () => Promise<Answer<T>>): Promise<T> {
  for (let pause = 1; ; pause *= 2) {
    try {
      const { data, error, response } = await send();
      if (response.ok) return data as T;
      if (pause > 8 || ![429, 503].includes(response.status)) throw new Refused(JSON.stringify(error));
    } catch (broken) {
      if (pause > 8 || broken instanceof Refused) throw broken;
    }
    await sleep(pause);
  }
}
class Refused extends Error {}

// A POST with this key makes one thing, however often it is repeated.
const once = () => ({ header: { "Idempotency-Key": randomUUID() } });

async function save(path: string, file: string): Promise<void> {
  const bytes = await again(async () => {
    const response = await fetch(address + path, { headers });
    return { data: response.ok ? Buffer.from(await response.arrayBuffer()) : undefined, response };
  });
  await writeFile(file, bytes);
}

// 1. Describe the scanner
const constants = { source_to_cor_mm: 859.46, num_detector_pixels: 768, detector_pitch_mm: 1.502864583 };
const line = once();
const scanner = await again(() => api.POST("/v1/scanners", { params: line, body: { name: "Line 2", constants } }));

// 2. Send the scan
const file = await open(stack);
const { size } = await file.stat();
const begun = once();
let upload: Schemas["Upload"] = await again(() => api.POST("/v1/uploads", { params: begun, body: { size_bytes: size } }));
while (upload.state === "receiving") {
  const { buffer, bytesRead } = await file.read(Buffer.alloc(16 * 2 ** 20), 0, 16 * 2 ** 20, upload.offset_bytes);
  const sent = { ...headers, "Upload-Offset": String(upload.offset_bytes), "Content-Type": "application/octet-stream" };
  await fetch(`${address}/v1/uploads/${upload.id}`, {
    method: "PATCH", headers: sent, body: buffer.subarray(0, bytesRead),
  }).catch(() => sleep(1)); // the line broke, and the upload has the offset at which to continue
  const path = { upload_id: upload.id };
  upload = await again(() => api.GET("/v1/uploads/{upload_id}", { params: { path } }));
}
const query = { upload_id: upload.id, scanner_id: scanner.id, data: "counts", phantom_id: "l-shape", phantom_rows: "0:3" } as const;
const posted = once();
const scan = await again(() => api.POST("/v1/scans", { params: { query, ...posted } }));

// 3. Ask for a calibration
const requested = once();
const body = { scan_id: scan.id, activate: false };
let calibration = await again(() => api.POST("/v1/calibrations", { params: requested, body }));

// 4. Wait
while (calibration.state === "queued" || calibration.state === "running") {
  const params = { path: { calibration_id: calibration.id }, query: { wait: 30 } };
  calibration = await again(() => api.GET("/v1/calibrations/{calibration_id}", { params }));
}
if (calibration.state !== "succeeded") throw new Error(calibration.failure?.detail);

// 5. Read the verdict
const path = { calibration_id: calibration.id };
console.log(`calibration: ${calibration.verdict}, rays within ${calibration.predicted_ray_error_mm?.upper_95?.toFixed(3)} mm`);
const step = await again(() => api.GET("/v1/calibrations/{calibration_id}/next-step", { params: { path } }));
console.log(`next step: ${step.headline}`);
await save(`/v1/calibrations/${calibration.id}/report.png`, "report.png");

// 6. Accept the calibration
const accepted = once();
await again(() => api.POST("/v1/calibrations/{calibration_id}/activate", { params: { path, ...accepted } }));

// 7. Reconstruct the log
const rows = { scan_id: scan.id, rows: "3:6" };
const made = once();
let log = await again(() => api.POST("/v1/reconstructions", { params: made, body: rows }));
while (log.state === "queued" || log.state === "running") {
  const params = { path: { reconstruction_id: log.id }, query: { wait: 30 } };
  log = await again(() => api.GET("/v1/reconstructions/{reconstruction_id}", { params }));
}
if (log.failure) throw new Error(log.failure.detail);
await save(`/v1/reconstructions/${log.id}/slices/0.png`, "slice.png");
await save(`/v1/reconstructions/${log.id}/volume.h5`, "volume.h5");

// 8. Check a log for drift
const checked = once();
let drift = await again(() => api.POST("/v1/drifts", { params: checked, body: rows }));
while (drift.state === "queued" || drift.state === "running") {
  const params = { path: { drift_id: drift.id }, query: { wait: 30 } };
  drift = await again(() => api.GET("/v1/drifts/{drift_id}", { params }));
}
console.log(`drift: ${drift.result?.reason}`);

// 9. Follow the events
const since = new URLSearchParams({ scanner_id: scanner.id, after: "0", duration_s: "2" });
const events = await (await fetch(`${address}/v1/events?${since}`, { headers })).text();
for (const [, type] of events.matchAll(/^event: (.*)$/gm)) console.log(type);

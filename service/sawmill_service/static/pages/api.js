// How pages call the service: the session's token beside the cookie, problems as errors with their sentence.
export const AGAIN_MS = 2000;
const token = document.querySelector('meta[name="csrf-token"]')?.content;

export class Problem extends Error {
  constructor(problem, status) {
    super(status === 401 ? document.body.dataset.ended : problem?.detail ?? (status ? `status ${status}` : document.body.dataset.unreachable));
    this.code = problem?.code ?? "unreachable";
    this.status = status;
    this.errors = problem?.errors ?? [];
  }
}

function headers(more = {}) {
  return token ? { ...more, "X-CSRF-Token": token } : more;
}

// A JSON answer, or null where there is none; what is refused is thrown as a Problem.
export async function api(method, path, body) {
  const sent = body === undefined ? {} : { body: JSON.stringify(body) };
  const type = body === undefined ? {} : { "Content-Type": "application/json" };
  const all = headers({ Accept: "application/json", ...type });
  const answer = await fetch(path, { method, headers: all, ...sent }).catch(() => {
    throw new Problem(null, 0);
  });
  const text = await answer.text();
  const content = text ? JSON.parse(text) : null;
  if (!answer.ok) {
    throw new Problem(content, answer.status);
  }
  return content;
}

// Sends bytes as a body and answers with the JSON; onProgress(bytes sent). Aborted by the signal.
function send(method, path, body, more, onProgress, signal) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open(method, path);
    for (const [name, value] of Object.entries(headers({ Accept: "application/json", ...more }))) {
      request.setRequestHeader(name, value);
    }
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.responseType = "json";
    request.upload.addEventListener("progress", (event) => onProgress(event.loaded));
    request.addEventListener("load", () =>
      request.status < 300 ? resolve(request.response) : reject(new Problem(request.response, request.status)));
    request.addEventListener("error", () => reject(new Problem(null, 0)));
    request.addEventListener("abort", () => reject(new DOMException("aborted", "AbortError")));
    signal?.addEventListener("abort", () => request.abort());
    request.send(body);
  });
}

// A file as the body of one request; onProgress(sent, total) in bytes.
export function upload(path, file, onProgress) {
  return send("POST", path, file, {}, (sent) => onProgress(sent, file.size));
}

function waitFor(milliseconds, signal) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, milliseconds);
    signal.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(new DOMException("aborted", "AbortError"));
    });
  });
}

const keptName = (file) => `upload ${file.name} ${file.size} ${file.lastModified}`;

// A file's name as the service takes it.
export function nameOf(file) {
  return Array.from(file.name).slice(0, 200).join("") || "file";
}

// What was made of the upload is there: the same file is sent anew the next time.
export function forgetUpload(file) {
  localStorage.removeItem(keptName(file));
}

// The upload of a file that this browser began and that the service still has, or a new one.
async function begunUpload(file) {
  const earlier = localStorage.getItem(keptName(file));
  const found = earlier && await api("GET", `/v1/uploads/${earlier}`).catch((problem) => {
    if (problem.status !== 404) throw problem;
  });
  if (found && found.state !== "used") {
    return found;
  }
  const upload = await api("POST", "/v1/uploads", { size_bytes: file.size, name: nameOf(file) });
  localStorage.setItem(keptName(file), upload.id);
  return upload;
}

// Sends a file in parts and answers with the upload's id: a break of the connection, or the same file chosen again
// later, goes on where it ended. onProgress(sent, total, whether the connection is there). The signal may come at any
// time, also while the service is asked for an upload.
export async function uploadInParts(file, onProgress, signal) {
  let upload = await begunUpload(file);
  const path = `/v1/uploads/${upload.id}`;
  const remove = () => {
    forgetUpload(file);
    api("DELETE", path).catch(() => {}); // it is removed by itself after a day
  };
  if (signal.aborted) {
    remove();
  } else {
    signal.addEventListener("abort", remove);
  }
  signal.throwIfAborted();
  while (upload.offset_bytes < file.size) {
    const offset = upload.offset_bytes;
    try {
      upload = await send("PATCH", path, file.slice(offset), { "Upload-Offset": offset },
        (sent) => onProgress(offset + sent, file.size, true), signal);
    } catch (problem) {
      if (problem.code !== "unreachable" && problem.status !== 409) throw problem;
      onProgress(offset, file.size, false);
      await waitFor(AGAIN_MS, signal);
      upload = await api("GET", path).catch((again) => {
        if (again.code !== "unreachable") throw again;
        return upload;
      });
      signal.throwIfAborted();
    }
  }
  return upload.id;
}

// A form without a method is sent by a script. Its buttons wait for the script: the browser itself would load the page
// again, without what was written.
export function enableForms() {
  document.querySelectorAll("form:not([method]) button:disabled").forEach((button) => {
    button.disabled = false;
  });
}

// Calls onJob with the job at each change, until it has ended; answers with the ended job. A browser gives up a stream
// that is refused, as behind a proxy while the service starts: it is opened again once the job can be asked for.
export function followJob(id, onJob) {
  const path = `/v1/jobs/${encodeURIComponent(id)}`;
  return new Promise((resolve, reject) => {
    function follow() {
      const stream = new EventSource(`${path}/events`);
      let last;
      stream.addEventListener("job", (event) => {
        last = JSON.parse(event.data);
        onJob(last);
      });
      stream.addEventListener("end", () => {
        stream.close();
        resolve(last);
      });
      stream.addEventListener("error", () => {
        if (stream.readyState === EventSource.CLOSED) {
          setTimeout(lookAgain, AGAIN_MS);
        }
      });
    }

    async function lookAgain() {
      try {
        await api("GET", path);
      } catch (problem) {
        if (problem.status === 401) {
          location.reload(); // to the login: the session has ended
        } else if ([403, 404].includes(problem.status)) {
          reject(problem);
        } else {
          setTimeout(lookAgain, AGAIN_MS);
        }
        return;
      }
      follow();
    }

    follow();
  });
}

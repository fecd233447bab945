// How pages call the service: the session's token beside the cookie, problems as errors with their sentence.
const token = document.querySelector('meta[name="csrf-token"]')?.content;

export class Problem extends Error {
  constructor(problem, status) {
    super(problem?.detail ?? `status ${status}`);
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
  const answer = await fetch(path, { method, headers: headers({ Accept: "application/json", ...type }), ...sent });
  const text = await answer.text();
  const content = text ? JSON.parse(text) : null;
  if (!answer.ok) {
    throw new Problem(content, answer.status);
  }
  return content;
}

// A file as the body; onProgress(sent, total) in bytes. Aborted by the signal.
export function upload(path, file, onProgress, signal) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    for (const [name, value] of Object.entries(headers({ Accept: "application/json" }))) {
      request.setRequestHeader(name, value);
    }
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.responseType = "json";
    request.upload.addEventListener("progress", (event) => onProgress(event.loaded, event.total));
    request.addEventListener("load", () =>
      request.status < 300 ? resolve(request.response) : reject(new Problem(request.response, request.status)));
    request.addEventListener("error", () => reject(new Problem(null, 0)));
    request.addEventListener("abort", () => reject(new DOMException("aborted", "AbortError")));
    signal?.addEventListener("abort", () => request.abort());
    request.send(file);
  });
}

// Calls onJob with the job at each change, until it has ended; answers with the ended job.
export function followJob(id, onJob) {
  return new Promise((resolve) => {
    const stream = new EventSource(`/v1/jobs/${encodeURIComponent(id)}/events`);
    let last;
    stream.addEventListener("job", (event) => {
      last = JSON.parse(event.data);
      onJob(last);
    });
    stream.addEventListener("end", () => {
      stream.close();
      resolve(last);
    });
  });
}

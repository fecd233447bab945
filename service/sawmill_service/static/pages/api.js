// How pages call the service: the session's token beside the cookie, problems as errors with their sentence.
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

// A form without a method is sent by a script. Its buttons wait for the script: the browser itself would load the page
// again, without what was written.
export function enableForms() {
  document.querySelectorAll("form:not([method]) button:disabled").forEach((button) => {
    button.disabled = false;
  });
}

export const AGAIN_MS = 2000;

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

"""A browser's own stream of a job, which comes back by itself when one service ends and another one begins."""

import pytest

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_vocabulary import Progress

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]

FOLLOW = """path => {
  window.heard = [];
  window.stream = new EventSource(path);
  for (const name of ["job", "end", "closing"]) {
    window.stream.addEventListener(name, event => {
      window.heard.push({name, id: event.lastEventId, data: JSON.parse(event.data)});
    });
  }
}"""


def test_an_event_source_goes_on_with_the_next_service_and_ends_for_good(browser, serve, store, worker):
    asked = store.calibrations.accept(CalibrationAsk(scan_id="example"))
    with serve(0) as port:
        page = browser.new_page(base_url=f"http://127.0.0.1:{port}", bypass_csp=True)
        page.goto("/problems/")
        page.evaluate(FOLLOW, f"/v1/jobs/{asked.job_id}/events")
        claim = worker.claim()
        store.jobs.heartbeat(claim, Progress(fraction=0.25, stage="search"))
        page.wait_for_function("heard.some(({data}) => data.progress?.fraction === 0.25)")
    page.wait_for_function("heard.at(-1).name === 'closing' && stream.readyState === EventSource.CONNECTING")
    store.jobs.heartbeat(claim, Progress(fraction=0.5, stage="search"))  # while nobody listens
    with serve(port):
        page.wait_for_function("heard.some(({data}) => data.progress?.fraction === 0.5)")
    page.wait_for_function("heard.filter(({name}) => name === 'closing').length === 2")
    store.jobs.release(claim)
    worker.finish_calibration()
    with serve(port):
        # It was not closed by the page: it came back after the end, and was answered that nothing follows.
        page.wait_for_function("stream.readyState === EventSource.CLOSED")
        heard = page.evaluate("heard")
    page.context.close()
    assert [event["name"] for event in heard].count("end") == 1
    assert [(event["name"], event["data"]) for event in heard[-1:]] == [("end", "succeeded")]
    assert (heard[-2]["name"], heard[-2]["data"]["state"]) == ("job", "succeeded")
    latest, ended = store.events.numbers_of_job(asked.job_id)
    assert [event["id"] for event in heard[-2:]] == [str(latest), str(ended)]
    ids = [int(event["id"]) for event in heard]
    assert ids == sorted(ids)

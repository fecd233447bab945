#!/usr/bin/env bash
# Upload one phantom scan of counts, calibrate, and leave calibration.json and report.png in the current folder.
# Where the service asks for a token, SAWMILL_TOKEN brings it.
set -euo pipefail
if [ "$#" -ne 4 ]; then
  echo "usage: $0 API SCANNER_ID SCAN_FILE PHANTOM_ID, as in $0 http://127.0.0.1:8000 example scan.h5 l-shape" >&2
  exit 2
fi
api=$1 scanner=$2 file=$3 phantom=$4

# By a file, for a command's words can be read by everybody on the machine.
ask() {
  if [ -z "${SAWMILL_TOKEN:-}" ]; then curl -sS "$@"; return; fi
  curl -sS --config <(printf 'header = "Authorization: Bearer %s"\n' "$SAWMILL_TOKEN") "$@"
}
# What the service answers; a problem goes to standard error and ends the script.
call() {
  local answer
  answer=$(ask --fail-with-body "$@") || { echo "$answer" >&2; return 1; }
  echo "$answer"
}
field() { grep -o "\"$1\":\"[^\"]*\"" | head -n 1 | cut -d '"' -f 4; }

scan=$(call -X POST -T "$file" "$api/v1/scans?scanner_id=$scanner&data=counts&phantom_id=$phantom" | field id)
asked=$(call -H 'Content-Type: application/json' -d "{\"scan_id\": \"$scan\"}" "$api/v1/calibrations")
calibration=$(field id <<< "$asked")
call -N "$api/v1/jobs/$(field job_id <<< "$asked")/events" > /dev/null  # the stream ends with the job
call "$api/v1/calibrations/$calibration" > calibration.json
state=$(field state < calibration.json)
if [ "$state" != succeeded ]; then
  echo "calibration $calibration $state: $(field detail < calibration.json)" >&2
  exit 1
fi
ask --fail -o report.png "$api/v1/calibrations/$calibration/report.png"
echo "calibration $calibration: $(field verdict < calibration.json)"

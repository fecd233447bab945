#!/usr/bin/env bash
# Do the whole job of a scanner's software with curl (7.82 or later): whole_job.sh ADDRESS SCAN.h5
# docs/do/connect.md explains each step. SAWMILL_KEY is the key, where one is needed.
set -euo pipefail
if [ "$#" -ne 2 ]; then
  echo "usage: $0 ADDRESS SCAN.h5, as in $0 http://127.0.0.1:8000 mill.h5" >&2
  exit 2
fi
api=$1 stack=$2

# Repeats and refusals
# The key is passed as a file, because every user of the machine can read the arguments of a command.
call() {
  if [ -z "${SAWMILL_KEY:-}" ]; then curl -sS "$@"; return; fi
  curl -sS --config <(printf 'header = "Authorization: Bearer %s"\n' "$SAWMILL_KEY") "$@"
}
# Print the answer. curl itself repeats after 429 and 503, this loop after a broken connection; a refusal is 22.
# curl empties a file before it repeats: a pipe would have the refusals before the answer.
again() {
  local pause
  for pause in 1 2 4 8 0; do
    call --fail-with-body --retry 4 -o answer.json "$@" && { cat answer.json; return; }
    [ "$?" = 22 ] && { cat answer.json >&2; return 22; }
    sleep "$pause"
  done
  return 1
}
# Send a POST that makes one thing, however often it is repeated.
once() { again -X POST -H "Idempotency-Key: $(cat /proc/sys/kernel/random/uuid)" "$@"; }
# Print the first field of this name in JSON. A program with jq does better.
field() { grep -o "\"$1\":\"[^\"]*\"" | head -n 1 | cut -d '"' -f 4; }

# 1. Describe the scanner
constants='{"source_to_cor_mm": 859.46, "num_detector_pixels": 768, "detector_pitch_mm": 1.502864583}'
scanner=$(once --json "{\"name\": \"Line 2\", \"constants\": $constants}" "$api/v1/scanners" | field id)

# 2. Send the scan
upload=$(once --json "{\"size_bytes\": $(wc -c < "$stack")}" "$api/v1/uploads" | field id)
for pause in 0 1 1 2 2 4 8; do  # after a broken connection, and after wrong-offset or upload-busy
  sleep "$pause"
  offset=$(call --fail -I "$api/v1/uploads/$upload" | tr -d '\r' | sed -n 's/^upload-offset: //Ip') || continue
  tail -c "+$((offset + 1))" "$stack" |
    call --fail -X PATCH -H "Upload-Offset: $offset" -T - -o part.json "$api/v1/uploads/$upload" && break
done
scan=$(once "$api/v1/scans?upload_id=$upload&scanner_id=$scanner&data=counts&phantom_id=l-shape&phantom_rows=0:3" |
  field id)

# 3. Ask for a calibration
calibration=$(once --json "{\"scan_id\": \"$scan\", \"activate\": false}" "$api/v1/calibrations" | field id)

# 4. Wait
ended() {  # ended URL: print the resource after its job has succeeded
  local answer
  answer=$(again "$1?wait=30")
  case $(field state <<< "$answer") in
    queued | running) ended "$1" ;;
    succeeded) echo "$answer" ;;
    *) echo "$answer" >&2; return 1 ;;
  esac
}
ended "$api/v1/calibrations/$calibration" > calibration.json

# 5. Read the verdict
echo "calibration: $(field verdict < calibration.json)"
echo "next step: $(again "$api/v1/calibrations/$calibration/next-step" | field headline)"
call --fail -o report.png "$api/v1/calibrations/$calibration/report.png"

# 6. Accept the calibration
once "$api/v1/calibrations/$calibration/activate" > active.json

# 7. Reconstruct the log
log=$(once --json "{\"scan_id\": \"$scan\", \"rows\": \"3:6\"}" "$api/v1/reconstructions" | field id)
ended "$api/v1/reconstructions/$log" > log.json
call --fail -o slice.png "$api/v1/reconstructions/$log/slices/0.png"
rm -f volume.h5
for pause in 0 1 2 4 8; do  # -C - continues an interrupted download at the size of the file
  sleep "$pause"
  call --fail -C - -o volume.h5 "$api/v1/reconstructions/$log/volume.h5" && break
  [ "$pause" != 8 ] || { echo "volume.h5 was not received whole" >&2; exit 1; }
done

# 8. Check a log for drift
drift=$(once --json "{\"scan_id\": \"$scan\", \"rows\": \"3:6\"}" "$api/v1/drifts" | field id)
echo "drift: $(ended "$api/v1/drifts/$drift" | field reason)"

# 9. Follow the events
call --fail -N "$api/v1/events?scanner_id=$scanner&after=0&duration_s=2" | sed -n 's/^event: //p'

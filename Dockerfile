# The base: a Debian with Python 3.11. `make image` gives one that mmdebstrap made where no image registry can be reached.
ARG BASE=python:3.11-slim-bookworm

FROM ${BASE} AS build
RUN python -m venv /opt/sawmill
# The dependencies are a layer of their own, which a change of the sources leaves as it is.
COPY installation/hashes.txt /src/
RUN /opt/sawmill/bin/pip install --no-cache-dir --no-deps --only-binary=:all: --require-hashes --requirement /src/hashes.txt \
# A service runs no library's tests.
 && find /opt/sawmill/lib -depth -type d \( -name tests -o -name test \) -path '*/site-packages/*' -exec rm -r {} +
COPY pyproject.toml README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md LICENSE docker-compose.yml /src/
COPY docs /src/docs
COPY examples /src/examples
COPY service /src/service
COPY worker /src/worker
RUN /opt/sawmill/bin/pip install --no-cache-dir --no-deps /src \
 && /opt/sawmill/bin/pip uninstall --yes --quiet setuptools pip

FROM ${BASE}
ARG VERSION
LABEL org.opencontainers.image.title="sawmill-calibration" \
      org.opencontainers.image.description="Geometry calibration and sparse-view reconstruction for X-ray log scanners" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}"
# Numba's parallel kernels link to it where TBB has no wheel.
RUN apt-get update && apt-get install --yes --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/* /var/cache/apt
COPY --from=build /opt/sawmill /opt/sawmill
# The installation is read-only for the service's user: compiled kernels are kept beside it, in a folder of their own.
ENV PATH=/opt/sawmill/bin:$PATH \
    SAWMILL_DATA_FOLDER=/data \
    NUMBA_CACHE_DIR=/var/cache/sawmill
# The user's home is a folder that every container may write to and none keeps. Any other user id may run the image too.
RUN useradd --home-dir /tmp --uid 1000 sawmill && install --directory --mode=1777 /data /watched /var/cache/sawmill
USER sawmill
# A processor of another kind compiles them again at the first start.
RUN umask 0000 && sawmill compile
WORKDIR /data
VOLUME /data
EXPOSE 8000
# Of the API: a container that runs a worker has a check of its own (docker-compose.yml).
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s CMD ["python", "-c", "import http.client, sys; \
api = http.client.HTTPConnection('127.0.0.1', 8000, timeout=3); api.request('GET', '/health/ready'); \
sys.exit(api.getresponse().status != 200)"]
# On every address it starts only with SAWMILL_TOKEN or SAWMILL_TOKEN_FILE; SAWMILL_ALLOWED_HOSTS names how clients call it.
CMD ["sawmill", "serve", "--host", "0.0.0.0"]

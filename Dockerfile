FROM python:3.11-slim-bookworm AS build
COPY pyproject.toml constraints.txt README.md CHANGELOG.md LICENSE docker-compose.yml /src/
COPY docs /src/docs
COPY examples /src/examples
COPY service /src/service
COPY worker /src/worker
RUN python -m venv /opt/sawmill \
 && /opt/sawmill/bin/pip install --no-cache-dir --constraint /src/constraints.txt '/src[postgresql]'

FROM python:3.11-slim-bookworm
# Numba's parallel kernels link to it; without it a slower layer that forbids threads takes over.
RUN apt-get update && apt-get install --yes --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/sawmill /opt/sawmill
# The installation is read-only for the service's user: compiled kernels are kept beside it, in a folder of its own.
ENV PATH=/opt/sawmill/bin:$PATH \
    SAWMILL_DATA_FOLDER=/data \
    NUMBA_CACHE_DIR=/var/cache/sawmill
# Its home is what every container may write to and none keeps.
RUN useradd --home-dir /tmp --uid 1000 sawmill && install --directory --owner=sawmill /data /var/cache/sawmill
USER sawmill
# A processor of another kind compiles them again at the first start.
RUN sawmill compile
WORKDIR /data
VOLUME /data
EXPOSE 8000
# On every address it starts only with SAWMILL_TOKEN or SAWMILL_TOKEN_FILE; SAWMILL_ALLOWED_HOSTS names how clients call it.
CMD ["sawmill", "serve", "--host", "0.0.0.0"]

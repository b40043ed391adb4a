# syntax=docker/dockerfile:1
# docker build --target core -t remind .    on any machine
# docker build --target cuda -t remind .    with JAX for NVIDIA GPUs (driver 525 or later)
# docker run --rm -v "$PWD:/work" remind run rooms.mp4 --masks masks/

FROM python:3.12-slim AS wheel
WORKDIR /source
RUN pip install --no-cache-dir build==1.3.0
COPY pyproject.toml README.md LICENSE ./
COPY remind_jax remind_jax
COPY weights_convert weights_convert
COPY configs configs
RUN python -m build --wheel --outdir /dist

FROM python:3.12-slim AS core
RUN useradd --create-home --uid 1000 remind
COPY --from=wheel /dist/*.whl /tmp/
RUN pip install --no-cache-dir "$(ls /tmp/*.whl)[detect,hub]" && rm /tmp/*.whl
USER remind
WORKDIR /work
ENTRYPOINT ["remind"]
CMD ["--help"]

FROM core AS cuda
USER root
RUN pip install --no-cache-dir "jax[cuda12]"
USER remind

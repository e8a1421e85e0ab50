# taichi_sim in a container.
#   docker build -t taichi-sim .                                  for the CPU
#   docker build -t taichi-sim:cuda --target cuda .               for an NVIDIA GPU
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" taichi-sim run jelly -o jelly.mp4
#   docker run --rm --user "$(id -u):$(id -g)" --gpus all -v "$PWD:/data" taichi-sim:cuda run jelly -o jelly.mp4
#   docker run --rm -it -p 127.0.0.1:8080:8080 taichi-sim view jelly --web --host 0.0.0.0    then open the address that it prints,
#                                                                                             with 127.0.0.1 for the host

FROM python:3.12-slim AS wheel
WORKDIR /source
COPY pyproject.toml setup.py README.md LICENSE ./
COPY taichi_sim taichi_sim
COPY kernels kernels
COPY demos demos
COPY docs/course docs/course
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim AS base
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libx11-6 \
    && rm -rf /var/lib/apt/lists/*
RUN --mount=from=wheel,source=/wheels,target=/wheels \
    pip install --no-cache-dir "$(ls /wheels/*.whl)[mesh,text,usd,web]"
# any user may be named above: caches lie where all may write
ENV HOME=/tmp XDG_CACHE_HOME=/tmp/.cache
USER nobody
WORKDIR /data
ENTRYPOINT ["taichi-sim"]
CMD ["--help"]

# the driver comes from the host, with `--gpus all` and the NVIDIA Container Toolkit
FROM base AS cuda
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility

FROM base AS cpu

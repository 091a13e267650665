# accelsurf on a slim system, for commands and for `accelsurf serve`; no window.
#   docker build -t accelsurf .
#   docker run --rm -v "$PWD:/data" --user "$(id -u):$(id -g)" accelsurf segment scan.nii.gz -o out --inside ball:X,Y,Z,6
#   docker run --rm -p 127.0.0.1:1527:1527 -e NN_INTERACTIVE_API_KEY accelsurf serve --host 0.0.0.0
FROM python:3.13-slim AS build
WORKDIR /src
COPY . .
RUN pip install --no-cache-dir build && python -m build --wheel --outdir /dist

FROM python:3.13-slim
# What movies and pictures are drawn with, without a screen.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libgl1 libegl1 libgl1-mesa-dri fonts-dejavu-core \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /dist /dist
RUN wheel="$(echo /dist/*.whl)" && pip install --no-cache-dir "${wheel}[serve,zarr,dicom,tiff,mesh]" && rm -r /dist
# Compiled kernels lie where any user may read them, and add those of another processor.
ENV HOME=/home/accelsurf NUMBA_CACHE_DIR=/home/accelsurf/kernels
RUN useradd --home-dir "$HOME" --create-home --uid 1000 accelsurf && mkdir -p "$NUMBA_CACHE_DIR" /data \
    && chown -R accelsurf "$HOME" /data
USER 1000
RUN accelsurf warmup --quiet && chmod -R a+rwX "$HOME"
WORKDIR /data
EXPOSE 1527
ENTRYPOINT ["accelsurf"]
CMD ["--help"]

# The built-in demo:
#   docker build -t spatialviz . && docker run --rm -p 127.0.0.1:8080:8080 -v spatialviz:/own spatialviz
# A dataset of your own, and any other command (what it writes goes to /own, which is a volume):
#   docker run --rm -p 127.0.0.1:8080:8080 -v "$PWD/data:/data:ro" -v spatialviz:/own spatialviz \
#     view /data --host 0.0.0.0 --no-open-browser
# Open the address that is printed: its token lets one in. Publish the port to this machine alone, as above, and under
# the same number, since pages of another address are refused.
ARG PYTHON=3.13.5-slim-bookworm

FROM python:${PYTHON} AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY assets assets
COPY pipeline pipeline
COPY spatialviz spatialviz
RUN python3 -m venv /opt/spatialviz && /opt/spatialviz/bin/pip install --no-cache-dir . \
    && /opt/spatialviz/bin/pip uninstall --yes pip

FROM python:${PYTHON}
COPY --from=build /opt/spatialviz /opt/spatialviz
RUN useradd --uid 1000 --create-home viewer && install -d -o viewer -g viewer /own
# Labels, journals, notes and networks that are made, and what is computed once, lie in the volume.
ENV PATH=/opt/spatialviz/bin:$PATH PYTHONUNBUFFERED=1 XDG_DATA_HOME=/own SPATIALVIZ_CACHE=/own/cache
USER 1000
VOLUME /own
WORKDIR /own
EXPOSE 8080
# Without the token it answers 401, which is an answer.
HEALTHCHECK --start-period=30s CMD ["python", "-c", "import http.client as h; c = h.HTTPConnection('127.0.0.1', 8080, timeout=5); c.request('GET', '/'); c.getresponse()"]
ENTRYPOINT ["spatialviz"]
CMD ["view", "--host", "0.0.0.0", "--port", "8080", "--no-open-browser"]

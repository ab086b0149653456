# The built-in demo on port 8080:   docker build -t spatialviz . && docker run --rm -p 127.0.0.1:8080:8080 spatialviz
# A dataset of your own, and any other command:
#   docker run --rm -p 127.0.0.1:8080:8080 -v "$PWD/data:/data:ro" spatialviz \
#     view /data --host 0.0.0.0 --no-open-browser
# Open the address that is printed: its token lets one in. Publish the port to this machine alone, as above, and under
# the same number, since pages of another address are refused.
FROM python:3.11-slim
WORKDIR /app
COPY pyproject.toml README.md LICENSE ./
COPY pipeline pipeline
COPY spatialviz spatialviz
COPY assets assets
RUN pip install --no-cache-dir . && useradd --create-home viewer
USER viewer
WORKDIR /home/viewer
EXPOSE 8080
ENTRYPOINT ["spatialviz"]
CMD ["view", "--host", "0.0.0.0", "--port", "8080", "--no-open-browser"]

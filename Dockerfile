# fieldtwin without a display and without a graphics card: Mesa renders images in software.
#   docker build -t fieldtwin . && docker run --rm fieldtwin doctor
FROM debian:trixie-slim

RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        libegl1 libegl-mesa0 libopengl0 libgl1 libgl1-mesa-dri python3 python3-venv \
    && rm -rf /var/lib/apt/lists/*

# The versions of requirements.lock; its lines of hashes begin with a blank.
COPY . /src
RUN python3 -m venv /opt/fieldtwin \
    && sed -n 's/^\([^ ].*\) \\$/\1/p' /src/requirements.lock > /src/versions.txt \
    && /opt/fieldtwin/bin/python -m pip install --no-cache-dir -c /src/versions.txt /src \
    && rm -r /src

RUN useradd --create-home fieldtwin \
    && mkdir /data \
    && chown fieldtwin /data
USER fieldtwin
WORKDIR /data
ENV PATH=/opt/fieldtwin/bin:$PATH MUJOCO_GL=egl
ENTRYPOINT ["fieldtwin"]
CMD ["list"]

# One image for every role: docker build -t outrider:0.1.0 .
# Two more images add the dashboard's web server and MAVLink: docker build --target dashboard -t outrider-dashboard:0.1.0 .
# and docker build --target mavlink -t outrider-mavlink:0.1.0 .
# Behind a package mirror, pass pip's configuration as a secret, which leaves no trace: docker build --secret id=pip_conf,src=pip.conf .

# The base is any Debian image with Python 3.11 or newer. Pin it by its digest:
# docker build --build-arg BASE=python:3.11-slim@sha256:... ; docs/how-to/deployment.md shows where to find the digest.
ARG BASE=python:3.11-slim

# Build tools stay in the first stages.
FROM ${BASE} AS tools
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore PIP_NO_CACHE_DIR=1 PIP_CONSTRAINT=/build/constraints.txt
WORKDIR /build
COPY constraints.txt ./
RUN --mount=type=secret,id=pip_conf,target=/etc/pip.conf python -m pip install hatchling

FROM ${BASE} AS needs
COPY pyproject.toml ./
RUN python -c "import tomllib; project = tomllib.load(open('pyproject.toml', 'rb'))['project']; \
    extras = project['optional-dependencies']; \
    print(*project['dependencies'], *extras['tls'], *extras['ros2'], sep='\n')" >/needs.txt && \
    python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['dashboard'], sep='\n')" \
    >/dashboard.txt && \
    python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['mavlink'], sep='\n')" \
    >/mavlink.txt

# Install dependencies from their list alone, so that changes of the project do not reinstall them. Remove the test suites
# of large packages.
FROM tools AS dependencies
COPY --from=needs /needs.txt ./
RUN --mount=type=secret,id=pip_conf,target=/etc/pip.conf \
    python -m venv --without-pip /opt/outrider && \
    python -m pip --python /opt/outrider/bin/python install --requirement needs.txt && \
    cd /opt/outrider/lib/python3*/site-packages && find numba scipy matplotlib mpl_toolkits -type d -name tests -prune -exec rm -r {} +

FROM tools AS project
COPY pyproject.toml README.md LICENSE ./
COPY bus bus
COPY sim sim
COPY agents agents
COPY outrider outrider
COPY extensions extensions
RUN python -m pip wheel --no-deps --no-build-isolation --wheel-dir /wheels .

FROM ${BASE} AS flight
LABEL org.opencontainers.image.title="Outrider" org.opencontainers.image.licenses="Apache-2.0"
# Any user can write both folders, so that `user:` may be a user of the host.
RUN groupadd --gid 1000 outrider && useradd --uid 1000 --gid 1000 --no-create-home --home-dir /tmp outrider && \
    install -d -m 1777 -o outrider -g outrider /var/cache/outrider /runs
COPY --from=dependencies /opt/outrider /opt/outrider
RUN --mount=from=project,source=/wheels,target=/wheels \
    python -m pip --no-cache-dir --disable-pip-version-check --python /opt/outrider/bin/python install --no-deps --no-index /wheels/*.whl
ENV PATH=/opt/outrider/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 \
    OUTRIDER_CACHE=/var/cache/outrider MPLCONFIGDIR=/var/cache/outrider/matplotlib
USER 1000:1000
WORKDIR /runs
# One run compiles everything that the roles need and fills the font cache, so that containers start fast.
RUN outrider run escort --in-process --duration 1 --out /tmp/flight && rm -r /tmp/flight && \
    outrider run scouts --in-process --duration 3 --no-files && \
    python -P -c "from agents.warming import warm_up; from bus.keys import Role; warm_up(Role.UAV); warm_up(Role.UGV)" && \
    chmod -R a+rwX /var/cache/outrider
# A container is healthy if it reaches the router.
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s --retries=3 CMD ["python", "-P", "-c", "import os, socket; \
host, _, port = os.environ.get('OUTRIDER_CONNECT', 'tcp/127.0.0.1:17447').rpartition('/')[2].rpartition(':'); \
socket.create_connection((host.strip('[]'), int(port)), 2).close()"]
ENTRYPOINT ["outrider"]
CMD ["--help"]

# The dashboard needs a web server: a separate image on top of the simulation's, built on request.
FROM flight AS dashboard
USER 0:0
RUN --mount=type=secret,id=pip_conf,target=/etc/pip.conf --mount=from=needs,source=/dashboard.txt,target=/dashboard.txt \
    --mount=from=tools,source=/build/constraints.txt,target=/constraints.txt \
    PATH="${PATH#/opt/outrider/bin:}" python -m pip --no-cache-dir --disable-pip-version-check --python /opt/outrider/bin/python \
    install --constraint /constraints.txt --requirement /dashboard.txt
USER 1000:1000
EXPOSE 8080
CMD ["dashboard"]

# The bridge to ground stations is separate, too: pymavlink includes all dialects.
FROM flight AS mavlink
USER 0:0
RUN --mount=type=secret,id=pip_conf,target=/etc/pip.conf --mount=from=needs,source=/mavlink.txt,target=/mavlink.txt \
    --mount=from=tools,source=/build/constraints.txt,target=/constraints.txt \
    PATH="${PATH#/opt/outrider/bin:}" python -m pip --no-cache-dir --disable-pip-version-check --python /opt/outrider/bin/python \
    install --constraint /constraints.txt --requirement /mavlink.txt
USER 1000:1000
CMD ["mavlink"]

# `docker build` builds the last stage by default.
FROM flight

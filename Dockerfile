# Ubuntu 24.04 with ROS 2 Jazzy from apt, and this package built beside it:
#
#   docker build -t elastic_arm . && docker run -it --rm elastic_arm elastic-arm
FROM ros:jazzy-ros-base

# ROS's archive keeps the latest versions alone, so that none can be pinned.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends build-essential python3-venv \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /workspace
SHELL ["/bin/bash", "-c"]

# What changes less often comes first: the libraries are kept when only the code is new.
COPY package.xml requirements-jazzy.txt src/elastic_arm/
COPY msg_defs/package.xml src/elastic_arm/msg_defs/
RUN apt-get update && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src src/elastic_arm/msg_defs --ignore-src --rosdistro jazzy -y \
    && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv --system-site-packages .venv && touch .venv/COLCON_IGNORE \
    && .venv/bin/pip install --no-cache-dir -r src/elastic_arm/requirements-jazzy.txt

COPY . src/elastic_arm
RUN . /opt/ros/jazzy/setup.bash && . .venv/bin/activate \
    && colcon build --base-paths src src/elastic_arm/msg_defs

# The command line lies where `ros2 run` looks for it.
ENV PATH=/workspace/install/elastic_arm/lib/elastic_arm:/workspace/.venv/bin:$PATH
RUN sed -i '$i source /workspace/install/setup.bash --' /ros_entrypoint.sh
CMD ["bash"]

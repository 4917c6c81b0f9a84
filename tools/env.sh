# Source this for a shell in which the project's ROS 2 works: `. tools/env.sh`.
#
# The virtual environment is also the ROS prefix (lib/, share/, include/, like /opt/ros/jazzy). The wheels set the library
# path by starting every Python twice; with the path and their guard variable set here, once is enough.

_root=$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")/.." && pwd)
if [ ! -x "$_root/.venv/bin/python" ]; then
  echo "tools/env.sh: nothing is set up yet: run \`make setup\` in $_root first" >&2
  unset _root
  return 1
fi
export VIRTUAL_ENV="$_root/.venv"
export PATH="$VIRTUAL_ENV/bin:$PATH"
export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
export AMENT_PREFIX_PATH="$VIRTUAL_ENV${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"
export CMAKE_PREFIX_PATH="$VIRTUAL_ENV${CMAKE_PREFIX_PATH:+:$CMAKE_PREFIX_PATH}"
_libraries="$VIRTUAL_ENV/lib"
for _folder in "$VIRTUAL_ENV"/lib/python3*/site-packages/ros_*.libs; do
  [ -d "$_folder" ] && _libraries="$_libraries:$_folder"
done
export LD_LIBRARY_PATH="$_libraries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
# The demonstration and the tests talk over loopback; set this to SUBNET to reach other machines.
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
unset _root _libraries _folder

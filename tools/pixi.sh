# What pixi starts a shell with: the built packages, once there are any, and the command line beside the nodes.
if [ -f "$PIXI_PROJECT_ROOT/install/setup.sh" ]; then
  COLCON_CURRENT_PREFIX="$PIXI_PROJECT_ROOT/install"
  . "$PIXI_PROJECT_ROOT/install/setup.sh"
  unset COLCON_CURRENT_PREFIX
  export PATH="$PIXI_PROJECT_ROOT/install/elastic_arm/lib/elastic_arm:$PATH"
fi

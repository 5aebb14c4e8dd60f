"""A slow cell for a real robot to begin with: what has to be measured is empty, and refused."""

from __future__ import annotations

from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import atomic_path

HAND_DEVICES = {
    "allegro": 'driver = "allegro-can"\naddress = "can0"\n'
    'options = { generation = 4, side = "right", torque_share = 0.2 } # the generation is on the label',
    "inspire": 'driver = "inspire"\naddress = "192.168.11.210"\noptions = { speed = 100, force = 100 }',
    "leap": 'driver = "leap-dynamixel"\naddress = "/dev/ttyUSB0"\n'
    'options = { build = "", current_limit = 100 } # build: "full" or "lite"; [mA]',
}
"""How the device of a hand is told to begin, weak and slow."""

TEMPLATE = """\
# A robot with {hand}, slow, to begin with. Fill in what is empty: 'fungrasp robots check' says what that is.
# Then docs/robots/first-power-on.md, point by point.
name = "{name}"
hand = "{hand}"
stop_file = "stop" # the robot stops as soon as it exists

[arm]
model = "ur5e" # or "ur5", with a CB3 controller
driver = "ur-rtde"
address = "" # of the controller
options = {{ velocity = 0.3, acceleration = 1.0, jerk = 20.0 }} # [rad/s], [rad/s^2], [rad/s^3]
# Further options: payload = 1.5, payload_center = [0.0, 0.0, 0.06] # [kg], [m]: compared with the pendant's
# ROS's base_link in the world: z = 0 is the table top. The pendant's Base is turned by 180 degrees about z.
pose_world_base = [] # [m], wxyz
home = [] # [rad]: above the table, hand free

[mount]
pose_flange_hand = [] # [m], wxyz

[hand_device]
{device}

[tracker]
driver = "pose-stream"
address = "tcp://127.0.0.1:5556"
# calibration = "camera.toml" # of 'fungrasp robots calibrate'

# The pedestal, and whatever else the robot could touch.
# [[obstacles]]
# center = [-0.5, 0.0, 0.14] # [m]
# size = [0.25, 0.25, 0.28]

[workspace] # of the palm, as small as the task allows
lower = [-0.3, -0.3, 0.0]
upper = [0.3, 0.3, 0.5]
hand_depth = -0.005 # the hand stays 5 mm above the table; 0.012 once it may touch it

[limits]
palm_speed = 0.05 # [m/s]
palm_acceleration = 0.1
palm_rotation_speed = 0.3
arm_speed = 0.3 # [rad/s]
arm_acceleration = 0.5
hand_speed = 1.0
"""


def write_cell_template(path: str | Path, hand: str) -> None:
    """Write a slow cell for a real robot.

    Args:
        path: TOML file, which must not exist.
        hand: that it carries.

    Raises:
        FungraspError: the file exists, is no TOML file, or no device is known for the hand.
    """
    path = Path(path)
    if hand not in HAND_DEVICES:
        raise UnknownNameError("hand with a driver", hand, HAND_DEVICES)
    if path.suffix != ".toml":
        raise FungraspError(f"{path}: a cell is a .toml file")
    if path.exists():
        raise FungraspError(f"{path} exists already")
    with atomic_path(path) as temporary:
        text = TEMPLATE.format(name=path.stem, hand=hand, device=HAND_DEVICES[hand])
        temporary.write_text(text, encoding="utf-8")

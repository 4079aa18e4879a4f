"""Start one estimator beside a drive.

    ros2 launch friction_estimator estimator.launch.py config:=/path/estimator.yaml velocity:=/rig/velocity

Several joints of one JointState topic: joints:=shoulder,elbow,wrist (docs/joints.md).
Several shafts: include this file once for each, with another `namespace` (see two_shafts.launch.py).
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

INPUTS = ("velocity", "friction", "joint_states", "pressure", "temperature", "position")


def estimator(context):
    def value(name):
        return LaunchConfiguration(name).perform(context)

    parameters = {"use_sim_time": value("use_sim_time").lower() == "true"}
    joints = [name.strip() for name in value("joints").split(",") if name.strip()]
    if joints:
        parameters |= {"input.mode": "joint_state", "input.joints": joints}
    if value("state_file"):  # left alone where the parameter file names one
        parameters["state.file"] = value("state_file")
    return [
        Node(
            package="friction_estimator",
            executable="estimator_node",
            name="friction_estimator",
            namespace=value("namespace"),
            output="screen",
            emulate_tty=True,
            respawn=value("respawn").lower() == "true",
            respawn_delay=1.0,
            parameters=[value("config"), parameters],
            remappings=[(name, value(name)) for name in INPUTS],
            ros_arguments=["--log-level", value("log_level")],
        )
    ]


def generate_launch_description():
    config = PathJoinSubstitution([FindPackageShare("friction_estimator"), "config", "estimator.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="One for each shaft."),
            DeclareLaunchArgument("config", default_value=config, description="ROS parameter file."),
            DeclareLaunchArgument("joints", default_value="", description="Several of joint_states: shoulder,elbow."),
            DeclareLaunchArgument("state_file", default_value="", description="Keeps what was learned."),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="Take the time from /clock."),
            DeclareLaunchArgument("respawn", default_value="true", description="Start again, warm, after a crash."),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn or error."),
            *(DeclareLaunchArgument(name, default_value=name, description=f"Topic of {name}.") for name in INPUTS),
            OpaqueFunction(function=estimator),
        ]
    )

"""Two shafts, one estimator each, in one launch file: copy it and name your own shafts.

    ros2 launch friction_estimator two_shafts.launch.py

The inputs are /left/velocity, /left/friction and /right/velocity, /right/friction; what each node learned is kept in
its own state file in the folder `state_folder`.
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

SHAFTS = ("left", "right")


def generate_launch_description():
    estimator = PathJoinSubstitution([FindPackageShare("friction_estimator"), "launch", "estimator.launch.py"])
    folder = LaunchConfiguration("state_folder")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "state_folder", default_value=[EnvironmentVariable("HOME"), "/.ros/friction_estimator"]
            ),
            *(
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(estimator),
                    launch_arguments={
                        "namespace": shaft,
                        "state_file": PathJoinSubstitution([folder, f"{shaft}.json"]),
                    }.items(),
                )
                for shaft in SHAFTS
            ),
        ]
    )

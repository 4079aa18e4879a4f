from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "friction_estimator"

# The floors are the versions of Ubuntu 24.04: what colcon builds there must not ask for more (docs/decisions/0094).
# requirements.in names the same ones; test/test_install.py holds both against package.xml.
REQUIRED = [
    "numpy>=1.26",
    "scipy>=1.11",
    "numba>=0.58",
    "PyWavelets>=1.5",
    "matplotlib>=3.6",
    "pandas>=2.1",
    "tqdm>=4.66",
    "PyYAML>=6.0",
    "jsonschema>=4.10",
    "rosbags>=0.11.0",
    "apsw",
    "lz4>=4.0",
    "backports.zstd; python_version < '3.14'",
]

EXTRAS = {
    "ros": ["ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-common-interfaces"],
    "page": ["bokeh>=3.4,<3.10"],
    "terminal": ["rich>=13.7"],
    "parquet": ["pyarrow>=14"],
    "cluster": ["distributed>=2024.1"],
    "docs": ["sphinx>=7.2,<9.1", "myst-parser>=2.0", "furo>=2024.1.29"],
    "test": ["pytest>=7.4,<9.2", "pytest-xdist>=3.5", "hypothesis>=6.98", "mujoco-core>=3.8"],
}

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "export/*.h.in", "report/page/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", glob("config/*")),
        (f"share/{PACKAGE}/launch", glob("launch/*.launch.py")),
    ],
    python_requires=">=3.11",
    install_requires=REQUIRED,
    zip_safe=True,
    maintainer="friction_estimator developers",
    maintainer_email="friction-estimator@users.noreply.github.com",
    description="Online identification of seal and actuator friction beside the drive, with diagnosis.",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    extras_require=EXTRAS,
    entry_points={
        "console_scripts": [
            f"friction_estimator = {PACKAGE}.cli.main:program",
            f"estimator_node = {PACKAGE}.ros.node:main",
            f"player = {PACKAGE}.cli.play:main",
        ],
    },
)

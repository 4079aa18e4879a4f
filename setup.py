from glob import glob

from setuptools import find_packages, setup

PACKAGE = "friction_estimator"

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
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="friction_estimator developers",
    maintainer_email="friction-estimator@users.noreply.github.com",
    description="Online identification of seal and actuator friction beside the drive, with diagnosis.",
    license="Apache-2.0",
    extras_require={"page": ["bokeh>=3.4"], "terminal": ["rich>=13.7"], "test": ["pytest"]},
    entry_points={
        "console_scripts": [
            f"friction_estimator = {PACKAGE}.cli.main:main",
            f"estimator_node = {PACKAGE}.ros.node:main",
            f"player = {PACKAGE}.cli.play:main",
        ],
    },
)

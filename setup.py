"""Package tss_ros, for colcon (ament_python) and for pip alike."""

import runpy
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

#: Executables of `ros2 run`, and the functions behind them.
EXECUTABLES = runpy.run_path(str(Path(__file__).with_name("tss_ros") / "executables.py"))[
    "EXECUTABLES"
]

setup(
    name="tss_ros",
    version="0.1.0",
    description="Spinning tethered satellite formations in ROS 2: simulation and Floquet stability",
    license="Apache-2.0",
    maintainer="tss_ros maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-809a8e3e.example",
    python_requires=">=3.10,<3.14",
    packages=find_packages(include=["tss_ros", "tss_ros.*"]),
    package_data={"tss_ros": ["py.typed", "scenarios/*.yaml", "ros/*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/tss_ros"]),
        ("share/tss_ros", ["package.xml"]),
        ("share/tss_ros/msg_configs", glob("msg_configs/*.yaml")),
        ("share/tss_ros/config", glob("config/*.yaml")),
        ("share/tss_ros/launch", glob("launch/*.launch.*")),
        ("share/tss_ros/layouts", glob("layouts/*")),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [f"{name} = tss_ros.executables:{name}" for name in EXECUTABLES]
    },
    # rclpy and the message packages come with ROS 2 and are declared in package.xml.
    install_requires=[
        "numpy>=2.0",
        "scipy>=1.13",
        "numba>=0.60",
        "llvmlite>=0.43",
        "PyYAML>=6.0",
        "google-re2>=1.1.20240702",
        "mcap>=1.6",
        "mcap-ros2-support>=0.6",
        "lz4>=4.3",
        "zstandard>=0.22",
        "matplotlib>=3.8.4",
        "markdown-it-py>=3.0",
        "pillow>=10",
        "pyarrow>=18",
        "rerun-sdk>=0.39",
    ],
    extras_require={
        # sweeps on a Dask cluster
        "cluster": ["distributed>=2025.1"],
        # tests and checks; colcon runs pytest where this extra names it
        "test": [
            "pytest>=8",
            "pytest-xdist>=3.6",
            "hypothesis>=6.100",
            "rosbags>=0.11",
            "pandas>=2.2.3",  # for the examples
            "import-linter>=2.15",
            "ruff>=0.15",
        ],
        # what `make` needs besides
        "dev": [
            "colcon-ros>=0.5",
            "colcon-bash>=0.5",
            "colcon-zsh>=0.5",
            "colcon-library-path>=0.2",
            "colcon-output>=0.2",
            "colcon-package-selection>=0.2",
            "colcon-parallel-executor>=0.4",
            "setuptools>=69,<80",  # later ones lack the `develop` options that colcon uses
            "empy>=3.3,<4",  # the message generators of Jazzy are written for empy 3
        ],
        # what `make docs` needs besides
        "docs": [
            "sphinx>=8.1",
            "numpydoc>=1.8",
            "myst-parser>=4.0",
            "sphinx-gallery>=0.18",
            "sphinx-design>=0.6",
            "pydata-sphinx-theme>=0.16",
        ],
    },
)

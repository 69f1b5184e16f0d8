"""Package tss_ros, for colcon (ament_python) and for pip alike."""

import runpy
import sys
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent  # colcon links this file into build/
#: Executables of `ros2 run`, and the functions behind them.
EXECUTABLES = runpy.run_path(str(HERE / "tss_ros" / "executables.py"))["EXECUTABLES"]
PLOTS = ["matplotlib>=3.8.4", "pillow>=10"]
TABLES = ["pyarrow>=18"]
#: What the simulation, the analysis, recording and reading bags do without.
EXTRAS = {
    # figures
    "plots": PLOTS,
    # sweeps and families, and tables for pandas, as CSV and Parquet
    "tables": TABLES,
    # results as figures and data frames
    "notebook": [*PLOTS, *TABLES, "pandas>=2.2.3"],
    # Rerun's viewer
    "review": ["rerun-sdk>=0.39", *PLOTS],
    # pages of interactive charts
    "page": ["plotly>=6.0", *PLOTS, *TABLES],
    # the report of the reproduction
    "reproduction": [*PLOTS, *TABLES, "markdown-it-py>=3.0"],
    # orbits from two-line elements
    "orbits": ["sgp4>=2.23"],
    # sweeps on a Dask cluster
    "cluster": ["distributed>=2025.1", *TABLES],
    # nodes, with the interfaces that colcon builds, where no ROS 2 is installed
    "ros": [
        f"ros-jazzy-{name}; platform_machine == 'x86_64'"
        for name in ("rclpy", "common-interfaces", "rmw-fastrtps-cpp", "fastrtps")
    ],
}
#: Who builds: pip makes a wheel, which has the one command `tss`; colcon installs or links an
#: executable for each name into lib/tss_ros (see setup.cfg), where `ros2 run` finds them.
BY_PIP = bool(
    {"bdist_wheel", "dist_info", "editable_wheel", "egg_info", "sdist"} & set(sys.argv)
) and not {"develop", "install"} & set(sys.argv)
SCRIPTS = ["tss = tss_ros.__main__:main"]
if not BY_PIP:
    SCRIPTS = [f"{name} = tss_ros.executables:{name}" for name in EXECUTABLES]

setup(
    name="tss_ros",
    version="0.1.0",
    description="Spinning tethered satellite formations in ROS 2: simulation and Floquet stability",
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    keywords="tethered satellites, Floquet theory, formation flying, ROS 2, orbital dynamics",
    url="https://doi.org/10.1007/s11071-022-07466-8",
    project_urls={"Paper": "https://doi.org/10.1007/s11071-022-07466-8"},
    classifiers=[
        "Development Status :: 4 - Beta",
        "Environment :: Console",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 14)),
        "Topic :: Scientific/Engineering :: Astronomy",
        "Topic :: Scientific/Engineering :: Physics",
        "Typing :: Typed",
    ],
    license="Apache-2.0",
    maintainer="tss_ros maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-809a8e3e.example",
    python_requires=">=3.10,<3.14",
    packages=find_packages(include=["tss_ros", "tss_ros.*"]),
    package_data={"tss_ros": ["py.typed", "scenarios/*.yaml", "ros/*.xml", "messages/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/tss_ros"]),
        ("share/tss_ros", ["package.xml"]),
        ("share/tss_ros/msg_configs", glob("msg_configs/*.yaml")),
        ("share/tss_ros/config", glob("config/*.yaml")),
        ("share/tss_ros/launch", glob("launch/*.launch.*")),
        ("share/tss_ros/layouts", glob("layouts/*")),
        *([("bin", ["setup_tools/tss"])] if not BY_PIP else []),
    ],
    zip_safe=False,
    entry_points={"console_scripts": SCRIPTS},
    # rclpy and the message packages come with ROS 2 and are declared in package.xml.
    install_requires=[
        "numpy>=2.0",
        "scipy>=1.13",
        "numba>=0.60",
        "llvmlite>=0.43",
        "PyYAML>=6.0",
        "argcomplete>=3.1",
        "google-re2>=1.1.20240702",
        "mcap>=1.6",
        "mcap-ros2-support>=0.6",
        "lz4>=4.3",
        "zstandard>=0.22",
    ],
    extras_require={
        **EXTRAS,
        # all that commands need besides ROS
        "all": sorted({p for name in EXTRAS if name != "ros" for p in EXTRAS[name]}),
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

"""Packages that `pip install tss_ros` leaves out, and what brings each of them.

Standard library only.
"""

#: The extra that has each package.
EXTRAS = {
    "matplotlib": "plots",
    "PIL": "plots",
    "pyarrow": "tables",
    "pandas": "notebook",
    "rerun": "review",
    "rerun_cli": "review",
    "markdown_it": "reproduction",
    "plotly": "page",
    "distributed": "cluster",
    "sgp4": "orbits",
}
#: Packages of ROS 2 and of this project's own interfaces.
ROS = (
    "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs",
    "rcl_interfaces", "rclpy", "rosgraph_msgs", "rpyutils", "sensor_msgs", "std_msgs", "std_srvs",
    "tf2_msgs", "tss_interfaces", "visualization_msgs",
)  # fmt: skip


def advice(error: ModuleNotFoundError) -> str:
    """What to do about a package that is not installed.

    Parameters
    ----------
    error : ModuleNotFoundError

    Returns
    -------
    str
        One sentence that names the package; "" if nobody here knows it.
    """
    package = (error.name or "").partition(".")[0]
    if package in EXTRAS:
        return f"needs {package}, which is not installed: pip install 'tss_ros[{EXTRAS[package]}]'"
    if package in ROS:
        return (
            f"needs ROS 2, and its package {package} is not found: use a checkout"
            " (`make setup`, then `. ./activate`), or build this package with colcon"
        )
    return ""

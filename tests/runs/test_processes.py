"""Nodes that are started together: those that fail are named."""

import pytest
from ros_harness import START_S, wait_until

from tss_ros.core import TssError
from tss_ros.runs.processes import Nodes


def test_a_node_that_fails_is_named_with_its_last_lines(tmp_path):
    with Nodes(tmp_path) as nodes:
        nodes.start("stability_node", satellite_mass_kg=-1.0)
        reason = "(?s)stability_node ended with status 1.*satellite_mass_kg"
        with pytest.raises(TssError, match=reason):
            wait_until(nodes.check, START_S, "the node to end")

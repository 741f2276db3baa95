"""Node graphs: ops, their order, and the checks that a YAML file goes through."""

from synfog_usd.camera.graph.engine import Bound, GraphRun, Node, NodeGraph
from synfog_usd.camera.graph.load import load_graph, make_graph
from synfog_usd.camera.graph.op import Auto, FromProfile, Op, Parameter, Port, Profile, Range, Registry

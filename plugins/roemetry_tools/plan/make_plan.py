"""From a scene file to its plan."""

from __future__ import annotations

from roemetry.config.scene import Scene
from roemetry.errors import PluginError
from roemetry.records import Plan
from roemetry.stages.registry import Registry, discover


def plan_of(scene: Scene, *, simulate: bool, registry: Registry | None = None) -> Plan:
    """Plan the rig of a scene by the planner that comes with its simulator, under the same name.

    With `simulate`, short simulations stand beside the prediction. Raises PluginError where the simulator's
    plugin has no planner, or one that reads another kind of scene, and StageError, with the reason, where
    the rig cannot measure a height.
    """
    registry = registry or discover()
    chosen = scene.simulator
    name = f"{chosen.registered.provider.name}/{chosen.registered.entry.name}"
    found = registry.find("planner", name)
    stage = registry.load(found)
    if not isinstance(chosen.options, stage.Options):
        raise PluginError(f"the planner `{name}` does not read the scenes of the simulator of this name")
    plan: Plan = stage(chosen.options).plan(simulate=simulate)
    return plan

"""The scenes of a bake: a stage translated once for each lighting, with the fog of each shot in it.

Takes an opened stage, a plan and a graph; gives a scene for a shot, as wide and dense as the graph's lens asks for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from synfog_usd.base.errors import ImageError, StageError
from synfog_usd.dataset.plan import CLEAR, BakePlan, Shot

if TYPE_CHECKING:
    from synfog_usd.base.fisheye import Fisheye
    from synfog_usd.base.notes import Note
    from synfog_usd.camera.graph import NodeGraph
    from synfog_usd.camera.pinhole import Pinhole
    from synfog_usd.scene import Camera, SceneDict
    from synfog_usd.stage import Stage


class Scenes:
    """The scenes of a stage: one translation for each lighting, and one more for what differs from it in more than its
    fog.
    """

    def __init__(
        self,
        stage: Stage,
        plan: BakePlan,
        graph: NodeGraph | None = None,
        *,
        lightings: dict[str, Any] | None = None,
        before: Mapping[str, Any] | None = None,
    ) -> None:
        """`lightings` are the translations that the cameras of a rig share; `before` those of another frame."""
        from synfog_usd import stage as usd

        self.stage, self.plan, self.graph, self.authored = stage, plan, graph, usd.selected(stage)
        self.lightings: dict[str, Any] = {} if lightings is None else lightings
        self.before = before or {}
        self.sensor: Pinhole | None = None  # what the sensor takes, where a wider picture is rendered
        self.told: dict[Shot, tuple[Note, ...]] = {}  # what the shots that were surveyed had to report
        self.foggy = False  # whether one of them has fog
        self.known: dict[Shot, SceneDict] = {}
        self.light: dict[str, str] = {}  # by lighting: how light it is outdoors, in words and numbers

    def of(self, shot: Shot) -> SceneDict:
        """The scene of a shot; what it was translated from is held, unless it serves no other shot."""
        from synfog_usd import stage as usd
        from synfog_usd.dataset.wet import rained_on
        from synfog_usd.translate import Exchange, StageView, outdoors

        if shot in self.known:
            return self.known[shot]
        plan = self.plan
        usd.select(
            self.stage,
            fog=shot.fog_variant or self.authored.get("fog"),  # '' where the stage itself chooses none
            lighting=shot.lighting_variant or self.authored.get("lighting"),
        )
        first = plan.rig[0] if plan.rig else plan.camera
        view = StageView(first, plan.frame, plan.size, shot.fog_override, plan.reads.lights, plan.reads.light_scale)
        if fresh := shot.lighting not in self.lightings:
            before = self.before.get(shot.lighting) or next(iter(self.lightings.values()), None)
            self.lightings[shot.lighting] = Exchange(self.stage, view, rig=plan.rig[1:], before=before)
        entry = self.lightings[shot.lighting]
        if shot.lighting not in self.light:
            self.light[shot.lighting] = outdoors(entry.scene).sentence(plan.reads.light_scale)
        scene: SceneDict | None = entry.scene
        if not fresh or plan.camera != first:
            scene = entry.within(self.stage, fog=shot.fog_override, camera=plan.camera)
        if scene is None:
            scene = Exchange(self.stage, replace(view, camera=plan.camera)).scene
            return self.through_lens(rained_on(scene))
        self.known[shot] = self.through_lens(rained_on(scene))
        return self.known[shot]

    def through_lens(self, scene: SceneDict) -> SceneDict:
        """The scene through the graph's fisheye; or through a wider and denser camera, where its lens distorts and
        every pixel has to be found in the picture.

        Raises:
            StageError: a fisheye before an orthographic camera, or one whose picture ends before its corners.
        """
        from synfog_usd.camera import distortion, fisheye

        if self.graph is not None and (lens := fisheye.of_graph(self.graph)) is not None:
            neighbours = tuple(replace(eye, fisheye=lens, fov_x_deg=lens.fov_x_deg) for eye in scene.further_cameras)
            return _through(replace(scene, further_cameras=neighbours), lens)

        def wider(eye: Camera) -> Camera:
            plane = self.graph is not None and not eye.width_m > 0.0
            rendered = distortion.to_render(self.graph, pinhole_of(eye)) if self.graph and plane else None
            return eye if rendered is None else replace(eye, **size_of(rendered))

        eye = wider(scene.camera)
        if eye is scene.camera:
            return scene
        self.sensor = pinhole_of(scene.camera)
        return replace(scene, camera=eye, further_cameras=tuple(wider(further) for further in scene.further_cameras))

    def survey(self, todo: Sequence[Shot]) -> None:
        """Read every lighting once and every fog once, that were not read yet."""
        for shot in _each_once(todo):
            if shot not in self.told:
                scene = self.of(shot)
                self.told[shot] = tuple(scene.notes)
                self.foggy |= bool(scene.fog)

    def notes(self, todo: Sequence[Shot]) -> tuple[Note, ...]:
        """What the lightings and fogs of some shots had to report, as far as they were surveyed, and what of the
        camera is guessed.
        """
        all_notes = (note for shot in _each_once(todo) for note in self.told.get(shot, ()))
        return tuple(dict.fromkeys([*all_notes, *_guessed(self.graph)]))


def _guessed(graph: NodeGraph | None) -> list[Note]:
    from synfog_usd.base.notes import Note
    from synfog_usd.camera.profiles import guessed

    guesses = {
        kind: guessed(profile)  # type: ignore[arg-type]
        for kind, profile in (graph.profiles.items() if graph is not None else ())
    }
    return [Note("info", "", f"{kind} {text}") for kind, text in guesses.items() if text]


def _each_once(todo: Sequence[Shot]) -> list[Shot]:
    """The first shots of every lighting and of every fog."""
    result, lightings, fogs = list[Shot](), set[str](), set[str]()
    for shot in todo:
        if shot.lighting not in lightings or shot.fog not in fogs:
            result.append(shot)
            lightings.add(shot.lighting)
            fogs.add(shot.fog)
    return result


def _through(scene: SceneDict, lens: Fisheye) -> SceneDict:
    from synfog_usd.base.notes import Note
    from synfog_usd.camera import fisheye
    from synfog_usd.translate.volume import refuse_cut

    view = replace(scene.camera, fisheye=lens, fov_x_deg=lens.fov_x_deg)
    if scene.camera.width_m > 0.0:
        raise StageError(f"{view.path}: an orthographic camera has no fisheye before it; name another with --camera")
    try:
        fisheye.angles_rad(lens, view.height_px, view.width_px, view.axis_shift)
    except ImageError as problem:
        raise StageError(f"{view.path}: a picture of {view.width_px} x {view.height_px}: {problem}") from problem
    refuse_cut(scene.fog, view)
    if not scene.camera.f_number > 0.0:
        return replace(scene, camera=view)
    sharp = Note("info", view.path, "its fStop blurs nothing: behind a fisheye all is drawn sharp")
    return replace(scene, camera=view, notes=(*scene.notes, sharp))


def size_of(pinhole: Pinhole) -> dict[str, Any]:
    """What of a camera a pinhole says."""
    return {
        "height_px": pinhole.height_px,
        "width_px": pinhole.width_px,
        "fov_x_deg": pinhole.fov_x_deg,
        "shift": (0.0 - pinhole.shift[0], 0.0 - pinhole.shift[1]),
    }


def pinhole_of(view: Camera) -> Pinhole:
    """A camera without its lens: size, angle and where its axis is."""
    from synfog_usd.camera.pinhole import Pinhole

    return Pinhole(view.height_px, view.width_px, view.fov_x_deg, view.axis_shift)


def cleared(stage: Stage, shot: Shot) -> Shot:
    """The shot with the stage's own clear air, where it has any."""
    from synfog_usd import stage as usd

    clear = CLEAR if CLEAR in usd.variants(stage).get("fog", ()) else None
    return replace(shot, fog_variant=clear or shot.fog_variant, fog_override=None)

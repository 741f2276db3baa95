"""The rule book of `check`: every rule with its severity, its meaning and its way out in the common tools.

Takes nothing; gives `RULES`, and findings of them.  The rules are tested in `synfog_usd.stage.rules` and
in the translation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

Severity = Literal["info", "warning", "error"]
TOOLS = ("Blender", "Houdini", "Omniverse")


@dataclass(frozen=True)
class Rule:
    """One thing that can be wrong.

    Attributes:
        name: as it is printed.
        severity: 'error' (a bake stops there), 'warning' (the picture will not be what
            was meant), 'info' (worth knowing).
        meaning: the fault, in one sentence.
        mend: tool -> what to do there.
    """

    name: str
    severity: Severity
    meaning: str
    mend: Mapping[str, str]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, and where.

    Attributes:
        severity: as the rule's.
        path: prim path, or '' for the stage.
        text: the fault and what to do.
        rule: the rule's name; 'usd:...' for USD's own validators.
        mend: tool -> what to do there; empty where the text says it all.
    """

    severity: Severity
    path: str
    text: str
    rule: str = ""
    mend: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}), compare=False)


def _rule(name: str, severity: Severity, meaning: str, *mend: str) -> Rule:
    return Rule(name, severity, meaning, MappingProxyType(dict(zip(TOOLS, mend, strict=True))))


_LABEL_MEND = (
    "give the object a custom property 'cityscapes' of type String, or use the panel Synfog of the extension "
    "(synfog-usd plugin-path --blender)",
    "add a Labels LOP (or Edit Properties) for the token array semantics:labels:cityscapes",
    "Semantics Schema Editor: add a label with the taxonomy 'cityscapes'",
)
_CUT_MEND = (
    "move the camera or the fog box; lower Clip Start in the camera's properties",
    "Camera LOP: lower the near clipping plane, or move one of the two",
    "Camera > Clipping Range: lower the first number, or move one of the two",
)

RULES: Mapping[str, Rule] = MappingProxyType(
    {
        rule.name: rule
        for rule in (
            _rule(
                "composition",
                "warning",
                "A reference, payload or sublayer that USD cannot put in place; it is drawn without it.",
                "export again with all linked files beside the USD file",
                "check the file paths of Reference and Sublayer LOPs",
                "File > Collect Asset copies all files into one folder",
            ),
            _rule(
                "no-camera",
                "error",
                "Nothing to look with.",
                "add a camera, and tick Cameras when exporting",
                "add a Camera LOP",
                "Create > Camera",
            ),
            _rule(
                "refused",
                "error",
                "The translation refuses the stage; the text says why.",
                "mend the prim that is named and export again",
                "mend the prim that is named in an Edit Properties LOP",
                "mend the prim that is named in the Property panel",
            ),
            _rule(
                "fog-crosses",
                "error",
                "Two fog boundaries cut through each other, so that nobody can tell which fog is where.",
                "scale or move one box until it lies wholly inside the other, or apart",
                "Transform LOP on one of the boundaries",
                "move or scale one of the boundaries",
            ),
            _rule("fog-cut", "error", "A fog's boundary lies between the camera and its near plane.", *_CUT_MEND),
            _rule(
                "camera-outside-fog",
                "warning",
                "A camera stands outside of every fog, so that it looks at a block of it.",
                "enlarge the fog box until the camera is in it, or move the camera",
                "Transform LOP on the fog, or on the camera",
                "scale the fog's prim, or move the camera",
            ),
            _rule(
                "units",
                "warning",
                "A road user whose size no such thing has; nearly always metersPerUnit or a forgotten scale.",
                "Scene Properties > Units: set Unit Scale 1, apply the object's scale, and export with Meters per "
                "Unit 1",
                "set metersPerUnit in a Configure Layer LOP, or scale the reference in its Transform",
                "reference the asset with the unit correction that the stage offers, or set Stage Units in Layer "
                "properties",
            ),
            _rule(
                "no-light",
                "warning",
                "Nothing shines: no light and no emissive material.",
                "add a sun or a world colour, and tick Lights and World Dome Light when exporting",
                "add a Dome Light or Distant Light LOP",
                "Create > Light > Dome Light",
            ),
            _rule(
                "black",
                "warning",
                "Light is there and none reaches the camera, so that the picture would be black; the text says why.",
                "move or turn the camera (View > Align View > Align Active Camera to View), or lower its Clip Start",
                "Camera LOP: move or turn it, or lower the near clipping plane",
                "move or turn the camera, or lower the first number of its Clipping Range",
            ),
            _rule(
                "light-bright",
                "warning",
                "A light that no lamp, sky or sun on a road is; the exposure will follow it and leave the rest black.",
                "lower the light's Power; its unit is watts",
                "lower Intensity and Exposure of the light, or switch Normalize off",
                "lower Intensity and Exposure in the light's properties",
            ),
            _rule(
                "label-unknown",
                "warning",
                "A label that Cityscapes does not have; it counts as unlabeled.",
                *_LABEL_MEND,
            ),
            _rule(
                "road-user-unlabelled",
                "warning",
                "A car, cyclist or person by its name that has no label, and so is missing in the ground truth.",
                *_LABEL_MEND,
            ),
            _rule(
                "overlaps",
                "warning",
                "Two road users whose boxes are in each other at a frame, though neither rides on the other.",
                "move a keyframe of one of them",
                "edit the time samples of one Transform LOP",
                "move a key of one of them in the Curve Editor",
            ),
            _rule(
                "floats",
                "warning",
                "A road user that is above or below the ground at a frame, by more than 0.25 m.",
                "move its keyframes onto the ground, or add a Shrinkwrap constraint",
                "project it onto the ground before the SOP Import",
                "move its keys onto the ground in the Curve Editor",
            ),
            _rule(
                "jumps",
                "warning",
                "A road user or another thing that moves between two frames as nothing on a road can.",
                "set the interpolation of its keyframes to linear or Bezier, and look for a key in the wrong place",
                "look for a missing time sample",
                "look for a key in the wrong place in the Curve Editor",
            ),
            _rule(
                "leaves-lane",
                "warning",
                "A vehicle that drove in a lane and is beside all lanes of the stage at a frame.",
                "lead it along the lane by a Follow Path constraint",
                "lead it along the lane's curve",
                "move its keys into the lane",
            ),
            _rule(
                "cuts",
                "info",
                "A camera that is elsewhere, or looks elsewhere, from one frame to the next.",
                "bake the frames before and after the cut by themselves; or key a camera for each view",
                "a Camera LOP for each view",
                "a camera for each view",
            ),
            _rule(
                "unlabelled", "info", "Shapes without a label; they are 'unlabeled' in the ground truth.", *_LABEL_MEND
            ),
            _rule(
                "no-fog",
                "info",
                "The stage has no fog of its own; `bake --fog mor150` makes a layer.",
                "add a box around everything with the panel Synfog of the extension (synfog-usd plugin-path "
                "--blender), or a custom property synfog:fog:mor",
                "a Cube with the applied schema SynFogMediumAPI and synfog:fog:mor",
                "a Cube with an attribute synfog:fog:mor (Add > Attribute, float)",
            ),
            _rule(
                "fog-solid",
                "info",
                "A fog boundary that other renderers draw as a solid box, because its purpose is not guide.",
                "use the panel Synfog of the extension, which sets it on export",
                "Configure Primitive LOP: purpose guide",
                "Property panel > Purpose: guide",
            ),
        )
    }
)
"""Every rule by name, gravest first."""


def finding(name: str, path: str, text: str) -> Finding:
    """A finding of a rule of ours."""
    rule = RULES[name]
    return Finding(rule.severity, path, text, name, rule.mend)

"""The parts of a scene file that every simulator reads alike: rig, belt, light, product, surface, targets.

A simulator's options are made of these models; one that knows more derives from them and adds fields, so that
one scene file serves all. The defaults are the herring roe rig. Lengths are in millimetres of the belt frame
(X along image x, Y towards the image's top, Z up from the belt), angles in degrees. What physics a simulator
makes of a part (of gloss, or of light below the surface) stands on its own page.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from roemetry.config.validation import unknown_key
from roemetry.errors import MisfitError, did_you_mean
from roemetry.io.files import is_file

Value = TypeVar("Value")

NONE = "none"
"""The family of an empty belt."""

BOARDS = ("charuco", "chessboard")
ON_BELT = "on_belt"
"""Pose of a board that lies on the belt."""

Place = Annotated[float, Field(ge=-1e5, le=1e5)]
Point = tuple[Place, Place, Place]
Row = tuple[Place, Place, Place, Place]
Share = Annotated[float, Field(ge=0, le=1)]
Factor = Annotated[float, Field(ge=0, le=10)]
Sizes = tuple[Annotated[float, Field(gt=0, le=1e4)], Annotated[float, Field(gt=0, le=1e4)]]


class Part(BaseModel):
    """A part of the scene: unknown keys are faults."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class DistortionPart(Part):
    """Lens distortion in OpenCV's model, on (x, y) = (pixel − principal point) / focal length."""

    k1: float = Field(default=0.0, ge=-5, le=5, description="radial, second order")
    k2: float = Field(default=0.0, ge=-50, le=50, description="radial, fourth order")
    p1: float = Field(default=0.0, ge=-1, le=1, description="tangential")
    p2: float = Field(default=0.0, ge=-1, le=1, description="tangential")
    k3: float = Field(default=0.0, ge=-500, le=500, description="radial, sixth order")


class FocusPart(Part):
    """Where the lens is sharp; beside that distance the thin lens's blur grows."""

    distance_mm: float = Field(gt=0, le=1e5, description="distance in focus, along the optical axis, mm")
    f_number: float = Field(gt=0.5, le=64, description="focal length over the aperture's diameter")


class CameraPart(Part):
    """The camera: sensor, lens, pose, exposure."""

    width_px: int = Field(default=640, ge=8, le=8192, description="image width, px")
    height_px: int = Field(default=480, ge=8, le=8192, description="image height, px")
    pixel_size_um: float = Field(default=10.0, gt=0.3, le=100, description="pitch of the square pixels, µm")
    focal_length_mm: float = Field(default=16.0, gt=0.5, le=1000, description="pinhole to sensor, mm")
    principal_point_px: tuple[Place, Place] | None = Field(
        default=None, description="where the optical axis meets the image, px; default: the image's centre"
    )
    distance_mm: float = Field(default=320.0, gt=1, le=1e5, description="pinhole to belt along the axis, mm")
    tilt_x_deg: float = Field(default=1.0, gt=-80, lt=80, description="turn about the camera's x axis")
    tilt_y_deg: float = Field(default=-0.4, gt=-80, lt=80, description="turn about the camera's y axis")
    T_belt_camera: tuple[Row, Row, Row, Row] | None = Field(
        default=None, description="full pose, to belt from camera, mm; replaces distance and tilts"
    )
    distortion: DistortionPart = Field(default_factory=DistortionPart, description="of the lens")
    focus: FocusPart | None = Field(
        default=None, description="where the lens is in focus; default: everywhere"
    )
    blur_sigma_px: float = Field(
        default=0.5, ge=0, le=20, description="standard deviation of the blur in focus, px"
    )
    exposure_ms: float = Field(default=10.0, gt=0, le=1e4, description="exposure time, ms")
    gain_dn_per_e: float = Field(default=0.0255, gt=0, le=100, description="grey levels per electron")
    full_well_e: float | None = Field(
        default=None, gt=0, le=1e7, description="electrons that a pixel can hold; default: unlimited"
    )
    read_noise_e: float = Field(
        default=39.2156862745098, ge=0, le=1e4, description="noise without light, electrons"
    )
    black_level_dn: float = Field(default=4.0, ge=0, le=10000, description="grey level without light")
    bit_depth: int = Field(default=8, ge=8, le=16, description="bits per grey level")

    @field_validator("T_belt_camera")
    @classmethod
    def _is_a_pose(cls, pose: Any) -> Any:
        if pose is None:
            return pose
        rotation = np.array(pose)[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise ValueError("its 3 × 3 part is not a rotation")
        if pose[2][3] <= 0.0:
            raise ValueError("the camera is not above the belt (its Z is not positive)")
        return pose


class LaserPart(Part):
    """The projector: a fan of laser planes from one point."""

    projector_mm: Point = Field(default=(160.0, -4.0, 300.0), description="position of the projector, mm")
    planes: int = Field(default=11, ge=1, le=200, description="number of planes")
    spacing_mm: float = Field(default=8.75, gt=0, le=1000, description="between the planes on the belt, mm")
    centre_x_mm: Place = Field(default=-3.0, description="X of the middle of the fan on the belt, mm")
    belt_x_mm: list[Place] | None = Field(
        default=None, min_length=1, max_length=200,
        description="X of each plane at Y = 0, Z = 0, mm; replaces planes, spacing and centre",
    )  # fmt: skip
    yaw_deg: float = Field(
        default=0.6, gt=-80, lt=80, description="angle between the lines and belt Y, degrees"
    )
    pitch_deg: float = Field(default=0.3, gt=-45, lt=45, description="rise of the lines' direction, degrees")
    line_width_mm: float = Field(default=1.24, gt=0, le=100, description="1/e² width at the waist, mm")
    waist_distance_mm: float = Field(default=336.0, ge=0, le=1e5, description="waist, from the projector, mm")
    divergence_mrad: float = Field(
        default=0.0, ge=0, le=500, description="growth of half the 1/e² width away from the waist, mrad"
    )
    peak_e_per_ms: float = Field(
        default=1450.980392156863, gt=0, le=1e9,
        description="light in a line's middle on white that faces the projector, electrons per pixel and ms",
    )  # fmt: skip
    power: list[Factor] | None = Field(
        default=None, description="of each plane, relative to peak_e_per_ms; 0 for a dead one; default: all 1"
    )
    fall_deg: float = Field(
        default=25.0,
        gt=0,
        le=1000,
        description="standard deviation over the angle along the line",
    )
    wavelength_nm: float = Field(default=660.0, ge=200, le=2000, description="wavelength, nm")
    speckle_contrast: float = Field(
        default=0.10, ge=0, le=1, description="standard deviation over mean of the speckle"
    )
    speckle_sigma_px: float | None = Field(
        default=0.7, ge=0, le=50,
        description="standard deviation of its grain, px; null: from wavelength, f-number and distance",
    )  # fmt: skip

    @model_validator(mode="after")
    def _fits(self) -> LaserPart:
        faults: list[tuple[tuple[str, ...], str]] = []
        if self.belt_x_mm is not None and np.any(np.diff(self.belt_x_mm) <= 0):
            faults.append((("belt_x_mm",), "must increase"))
        if self.power is not None and len(self.power) != self.count:
            faults.append((("power",), f"has {len(self.power)} entries for {self.count} planes"))
        elif self.power is not None and not any(self.power):
            faults.append((("power",), "every plane is dead; at least one must be above 0"))
        if self.projector_mm[2] <= 0.0:
            faults.append((("projector_mm",), "the projector is not above the belt (Z is not positive)"))
        if faults:
            raise MisfitError(*faults)
        return self

    @property
    def count(self) -> int:
        """Number of planes."""
        return self.planes if self.belt_x_mm is None else len(self.belt_x_mm)

    @property
    def lines_x_mm(self) -> NDArray[np.float64]:
        """X of each plane at Y = 0, Z = 0, shape (count,)."""
        if self.belt_x_mm is not None:
            return np.array(self.belt_x_mm, dtype=np.float64)
        order = np.arange(self.planes) - 0.5 * (self.planes - 1)
        return np.array(self.centre_x_mm + self.spacing_mm * order, dtype=np.float64)


class DirtPart(Part):
    """Dirt on the belt: round spots, anew for each item."""

    count: int = Field(default=0, ge=0, le=100000, description="spots in view")
    diameter_mm: Sizes = Field(default=(2.0, 8.0), description="smallest and largest diameter, mm")
    albedo: Share = Field(default=0.3, description="albedo relative to the clean belt")


class PatchPart(Part):
    """A rectangle of belt that gives less light back, or none: a hole, a splice, a soaked place."""

    x_mm: tuple[Place, Place] = Field(description="smallest and largest X, mm")
    y_mm: tuple[Place, Place] = Field(description="smallest and largest Y, mm")
    albedo: Share = Field(default=0.0, description="albedo relative to the clean belt")

    @model_validator(mode="after")
    def _has_a_size(self) -> PatchPart:
        faults = [((name,), "goes from a smaller to a larger number") for name in ("x_mm", "y_mm")
                  if not getattr(self, name)[0] < getattr(self, name)[1]]  # fmt: skip
        if faults:
            raise MisfitError(*faults)
        return self


class BeltPart(Part):
    """The belt and how it runs."""

    albedo_laser: Share = Field(default=0.66, description="reflected share of the laser light")
    albedo_plain: Share = Field(default=0.34, description="reflected share of the plain light")
    texture: Share = Field(default=0.04, description="relative standard deviation of the albedo")
    gloss: Share = Field(default=0.0, description="specular share")
    dirt: DirtPart = Field(default_factory=DirtPart, description="spots of dirt")
    patches: list[PatchPart] = Field(
        default_factory=list, description="dark rectangles; a later one covers earlier ones"
    )
    speed_mm_per_s: float = Field(default=200.0, ge=0, le=1e5, description="speed, mm/s")
    encoder_step_mm: float = Field(default=0.1, gt=0, le=1000, description="travel of an encoder count, mm")
    pitch_mm: float = Field(default=150.0, gt=0, le=1e5, description="travel from item to item, mm")


class StrayPart(Part):
    """A lamp that is on in all images and is reflected by glossy places."""

    position_mm: Point = Field(description="position, mm")
    e_per_ms: float = Field(gt=0, le=1e9, description="on white that faces it, electrons per pixel and ms")


class LightPart(Part):
    """The light that is not the laser's, and which images are taken."""

    ambient_e_per_ms: float = Field(
        default=54.90196078431373, ge=0, le=1e7,
        description="stray light on level white, electrons per pixel and ms",
    )  # fmt: skip
    plain_e_per_ms: float = Field(
        default=823.5294117647059, ge=0, le=1e7,
        description="plain light on level white, laser off, electrons per pixel and ms",
    )  # fmt: skip
    lamp_height_mm: float = Field(
        default=260.0, gt=0, le=1e5, description="height of the ring of lamps over the belt, mm"
    )
    lamp_radius_mm: float = Field(default=130.0, ge=0, le=1e5, description="radius of the ring of lamps, mm")
    stray: StrayPart | None = Field(default=None, description="a lamp that is always on")
    images: tuple[Literal["laser", "plain", "dark"], ...] = Field(
        default=("laser",), min_length=1, description="images of each item: laser, plain, dark (both off)"
    )


class BelowPart(Part):
    """Light that enters translucent food and leaves it at another place."""

    share: Share = Field(default=0.0, description="share of the light that enters")
    depth_mm: float = Field(default=0.0, ge=0, le=50, description="mean depth from which it returns, mm")
    blur_mm: float = Field(default=0.0, ge=0, le=100, description="standard deviation of its spread, mm")


class AlbedoMapPart(Part):
    """A picture that is laid on the product from straight above, over its footprint's extent."""

    file: Path = Field(description="image file of 8 or 16 bit, grey or colour; relative to the scene")
    black: Factor = Field(default=0.0, description="factor on the albedo where the picture is black")
    white: Factor = Field(default=1.0, description="factor on the albedo where the picture is white")

    @field_validator("file")
    @classmethod
    def _is_an_image(cls, file: Path) -> Path:
        if not is_file(file):
            raise ValueError("there is no such file")
        image = read_picture(file)
        if image is None or image.dtype not in (np.uint8, np.uint16):
            raise ValueError("not an image of 8 or 16 bit that can be read (PNG, TIFF, JPEG, …)")
        if min(image.shape[:2]) < 2:
            raise ValueError("an image of at least 2 × 2 pixels is needed")
        return file

    def factors(self) -> NDArray[np.float64]:
        """Read the picture as factors of the albedo, colours in the order blue, green, red."""
        image = read_picture(self.file)
        if image is None:
            raise MisfitError((("surface", "albedo_map", "file"), "cannot be read any more"))
        level = float(np.iinfo(image.dtype).max)
        return np.asarray(self.black + (self.white - self.black) * image.astype(np.float64) / level)


def read_picture(file: Path) -> NDArray[Any] | None:
    """Read an image of any depth, colours in the order blue, green, red; None where it is none."""
    import cv2

    data = np.fromfile(file, dtype=np.uint8)
    return None if data.size == 0 else cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)


class WetPart(Part):
    """Wet places on the product: round, and glossy."""

    count: int = Field(default=0, ge=0, le=100000, description="number of places per product")
    diameter_mm: Sizes = Field(default=(2.0, 6.0), description="smallest and largest diameter, mm")
    gloss: Share = Field(default=0.8, description="specular share")


class SurfacePart(Part):
    """What the product looks like."""

    albedo_laser: Share = Field(default=0.53, description="reflected share of the laser light")
    albedo_plain: Share = Field(default=0.62, description="reflected share of the plain light")
    texture: Share = Field(
        default=0.09, description="relative standard deviation of the albedo (blotches and grain)"
    )
    gloss: Share = Field(default=0.10, description="specular share")
    gloss_exponent: float = Field(default=25.0, ge=1, le=10000, description="exponent of the specular lobe")
    below: BelowPart = Field(default_factory=BelowPart, description="light below the surface")
    albedo_map: AlbedoMapPart | None = Field(
        default=None, description="a picture on the product; default: none"
    )
    wet: WetPart = Field(default_factory=WetPart, description="wet places")


def family_options(
    family: str,
    options: Mapping[str, Any],
    models: Mapping[str, type[BaseModel]],
    at: tuple[str | int, ...] = ("options",),
) -> Any:
    """Check the options of a family of products, which stand at some keys; None for the family `none`.

    Raises
    ------
    MisfitError
        With every fault: a family that is not among the models (with a close match), or options that do
        not fit its model.
    """
    if family == NONE:
        if options:
            raise MisfitError((at, "family `none` has no options"))
        return None
    if family not in models:
        meant = did_you_mean(family, models)
        unknown = f"there is no product family `{family}`{'; ' + meant if meant else '.'}"
        raise MisfitError((("family",), f"{unknown} There are: {', '.join((NONE, *models))}"))
    try:
        return models[family].model_validate(dict(options))
    except ValidationError as error:
        said = []
        for detail in error.errors():
            why = f"{detail['msg'][0].lower()}{detail['msg'][1:]}".removeprefix("value error, ")
            if detail["type"] == "extra_forbidden":
                why = unknown_key(detail["loc"][-1], list(models[family].model_fields))
            said.append(((*at, *detail["loc"]), why))
        raise MisfitError(*said) from None


class ItemPart(Part):
    """One product that was chosen, not counted up to."""

    seed: int = Field(ge=0, description="its seed")
    options: dict[str, Any] = Field(default_factory=dict, description="its own options")


class ProductPart(Part):
    """What lies on the belt: a family of products and its options; a simulator adds its default family."""

    family: str = Field(description="name of a family of products, or `none`")
    options: dict[str, Any] = Field(default_factory=dict, description="the family's own options")
    items: list[ItemPart] = Field(
        default_factory=list, description="the first products, by their seeds; further seeds count up"
    )
    in_frame: int = Field(default=1, ge=1, le=50, description="products in one frame, side by side")
    gap_mm: float = Field(
        default=3.0, ge=0, le=1000, description="smallest gap between two products of a frame, mm"
    )
    keep_in_reach: bool = Field(
        default=True, description="move a product along X so that the stripes and the view cover it"
    )
    most_overhang_spacings: float = Field(
        default=1.2, ge=0, le=100, description="how far it may reach beyond the outer stripes, in spacings"
    )

    def check_families(self, models: Mapping[str, type[BaseModel]]) -> None:
        """Raise MisfitError for a family or options, of all or of an item, that the models do not know."""
        family_options(self.family, self.options, models)
        for number, item in enumerate(self.items):
            family_options(self.family, self.options | item.options, models, ("items", number, "options"))


class BlockPart(Part):
    """The calibration block as it lies on the belt."""

    length_mm: float = Field(default=105.0, gt=0, le=5000, description="side across the stripes, mm")
    width_mm: float = Field(default=40.0, gt=0, le=5000, description="side along the stripes, mm")
    height_mm: float = Field(default=16.5, gt=0, le=2000, description="height, mm")
    centre_x_mm: Place = Field(default=1.5, description="X of its middle, mm")
    centre_y_mm: Place = Field(default=-1.0, description="Y of its middle, mm")
    yaw_deg: float = Field(default=0.9, ge=-180, le=180, description="angle from belt X, degrees")


class StaircasePart(Part):
    """The staircase, at the block's place: level steps that rise along the stripes."""

    steps: int = Field(default=4, ge=1, le=20, description="number of steps")
    tread_mm: float = Field(default=15.0, gt=0, le=1000, description="length of a step along the stripes, mm")
    riser_mm: float = Field(
        default=4.0, gt=0, le=500, description="height difference of neighbouring steps, mm"
    )
    width_mm: float = Field(default=105.0, gt=0, le=5000, description="side across the stripes, mm")


class BoardPart(Part):
    """The flat boards: a ChArUco board and a chessboard in several poses."""

    columns: int = Field(default=11, ge=3, le=50, description="squares along x")
    rows: int = Field(default=8, ge=3, le=50, description="squares along y")
    square_mm: float = Field(default=8.0, gt=0.1, le=500, description="side of a square, mm")
    marker_mm: float = Field(default=6.0, gt=0.05, le=500, description="side of a ChArUco marker, mm")
    dictionary: Literal["DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250"] = Field(
        default="DICT_4X4_250", description="OpenCV's name of the marker dictionary"
    )
    poses: int = Field(default=10, ge=1, le=100, description="poses of each board")
    thickness_mm: float = Field(default=2.0, gt=0, le=100, description="thickness of the plate, mm")
    tilt_max_deg: float = Field(default=18.0, ge=0, lt=60, description="largest tilt, degrees")
    height_mm: tuple[Place, Place] = Field(
        default=(0.0, 20.0), description="smallest and largest height of the middle, mm"
    )

    @model_validator(mode="after")
    def _fits(self) -> BoardPart:
        if self.marker_mm >= self.square_mm:
            raise MisfitError((("marker_mm",), f"must be less than square_mm, {self.square_mm:g}"))
        return self

    def print_picture(self, kind: str, px_per_square: int) -> NDArray[np.float64]:
        """Give a ``charuco`` or ``chessboard`` print, 0 ink to 1 paper, half a square of paper around it.

        Shape ((rows + 1) · px_per_square, (columns + 1) · px_per_square).
        """
        import cv2

        margin = px_per_square // 2
        if kind == "charuco":
            markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
            squares = (self.columns, self.rows)
            board = cv2.aruco.CharucoBoard(squares, self.square_mm, self.marker_mm, markers)
            size = ((self.columns + 1) * px_per_square, (self.rows + 1) * px_per_square)
            return np.asarray(board.generateImage(size, marginSize=margin) / 255.0)
        cells = np.add.outer(np.arange(self.rows), np.arange(self.columns)) % 2
        return np.pad(np.kron(cells, np.ones((px_per_square,) * 2)), margin, constant_values=1.0)


class TargetsPart(Part):
    """What is seen for calibration."""

    block: BlockPart = Field(default_factory=BlockPart, description="the block")
    staircase: StaircasePart = Field(default_factory=StaircasePart, description="the staircase")
    board: BoardPart = Field(default_factory=BoardPart, description="the flat boards")

    def truth(self, poses: Mapping[str, NDArray[np.float64]]) -> dict[str, Any]:
        """Give what is true of the targets, as plain values, with the poses T_belt_board (4, 4), mm."""
        board = self.board.model_dump(mode="json", exclude={"poses", "tilt_max_deg", "height_mm"})
        board["T_belt_board"] = {name: pose.tolist() for name, pose in poses.items()}
        return {
            "block": self.block.model_dump(mode="json"),
            "staircase": self.staircase.model_dump(mode="json"),
            **dict.fromkeys(BOARDS, board),
        }

    def views(self, take: Callable[[str, str], Value]) -> Mapping[str, Mapping[str, Value]]:
        """Give all calibration images by kind, then name; `take`, of both, makes one when it is asked for."""
        boards = [*(f"pose_{number:02d}" for number in range(1, self.board.poses + 1)), ON_BELT]
        lit = [f"{name}_{light}" for name in boards for light in ("plain", "laser")]
        names = {name: [name] for name in ("block", "belt", "staircase")} | dict.fromkeys(BOARDS, lit)
        return {kind: OnDemand(listed, partial(take, kind)) for kind, listed in names.items()}


class OnDemand(Mapping[str, Value]):
    """Values by name, each made when it is asked for."""

    def __init__(self, names: Sequence[str], make: Callable[[str], Value]) -> None:
        self._names, self._make = names, make

    def __getitem__(self, name: str) -> Value:
        if name not in self._names:
            raise KeyError(name)
        return self._make(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

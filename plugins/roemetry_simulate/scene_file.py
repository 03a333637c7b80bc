"""What a scene file says to the ray caster: the rig as its user knows it, the belt, the light, the product.

The defaults are the herring roe rig. Lengths are in millimetres of the belt frame: X along image x, Y towards
the image's top, Z up from the belt.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from roemetry.errors import MisfitError
from roemetry.stages import StageOptions
from roemetry_simulate.scene_optics import CameraPart, LaserPart, Part, Place, Point, Share

Sizes = tuple[Annotated[float, Field(gt=0, le=1e4)], Annotated[float, Field(gt=0, le=1e4)]]


class DirtPart(Part):
    """Dirt on the belt: round spots, anew for each item."""

    count: int = Field(default=0, ge=0, le=100000, description="spots in view")
    diameter_mm: Sizes = Field(default=(2.0, 8.0), description="smallest and largest diameter, mm")
    albedo: Share = Field(default=0.3, description="share of the clean belt's light that comes back")


class PatchPart(Part):
    """A rectangle of belt that gives less light back, or none: a hole, a splice, a soaked place."""

    x_mm: tuple[Place, Place] = Field(description="from X to X, mm")
    y_mm: tuple[Place, Place] = Field(description="from Y to Y, mm")
    albedo: Share = Field(default=0.0, description="share of the clean belt's light that comes back")

    @model_validator(mode="after")
    def _has_a_size(self) -> PatchPart:
        faults = [((name,), "goes from a smaller to a larger number") for name in ("x_mm", "y_mm")
                  if not getattr(self, name)[0] < getattr(self, name)[1]]  # fmt: skip
        if faults:
            raise MisfitError(*faults)
        return self


class BeltPart(Part):
    """The belt and how it runs."""

    albedo_laser: Share = Field(default=0.66, description="share of the laser's light that comes back")
    albedo_plain: Share = Field(default=0.34, description="share of the plain light that comes back")
    texture: Share = Field(default=0.04, description="relative deviation of the albedo")
    gloss: Share = Field(default=0.0, description="share of mirror-like light")
    dirt: DirtPart = Field(default_factory=DirtPart, description="spots of dirt")
    patches: list[PatchPart] = Field(default_factory=list, description="dark rectangles, the last one counts")
    speed_mm_per_s: float = Field(default=200.0, ge=0, le=1e5, description="speed, mm/s")
    encoder_step_mm: float = Field(
        default=0.1, gt=0, le=1000, description="belt travel of an encoder count, mm"
    )
    pitch_mm: float = Field(
        default=150.0, gt=0, le=1e5, description="belt travel from one item to the next, mm"
    )


class StrayPart(Part):
    """A lamp that is on in all images; glossy places mirror it."""

    position_mm: Point = Field(description="where it is, mm")
    e_per_ms: float = Field(
        gt=0, le=1e9, description="its light on white that faces it, electrons a pixel a ms"
    )


class LightPart(Part):
    """The light that is not the laser's, and which images are taken."""

    ambient_e_per_ms: float = Field(
        default=54.90196078431373,
        ge=0,
        le=1e7,
        description="stray light on level white, electrons a pixel a ms",
    )
    plain_e_per_ms: float = Field(
        default=823.5294117647059, ge=0, le=1e7,
        description="plain light on level white, laser off, electrons a pixel a ms",
    )  # fmt: skip
    lamp_height_mm: float = Field(default=260.0, gt=0, le=1e5, description="ring of lamps over the belt, mm")
    lamp_radius_mm: float = Field(default=130.0, ge=0, le=1e5, description="radius of the ring of lamps, mm")
    stray: StrayPart | None = Field(default=None, description="a lamp that is always on; default: none")
    images: tuple[Literal["laser", "plain", "dark"], ...] = Field(
        default=("laser",), min_length=1, description="images of each item: laser, plain, dark (both off)"
    )


class BelowPart(Part):
    """Light that goes on below the surface of translucent food and comes back somewhere else."""

    share: Share = Field(default=0.0, description="share of the light that goes below")
    depth_mm: float = Field(
        default=0.0,
        ge=0,
        le=50,
        description="mean depth it comes back from: it is shifted from the laser, mm",
    )
    blur_mm: float = Field(default=0.0, ge=0, le=100, description="spread of what comes back (deviation), mm")


class AlbedoMapPart(Part):
    """A picture that is laid on the product from straight above, over its footprint's extent."""

    file: Path = Field(description="image file of 8 or 16 bit, grey or colour; relative to the scene")
    black: float = Field(default=0.0, ge=0, le=10, description="factor of the albedo where it is black")
    white: float = Field(default=1.0, ge=0, le=10, description="factor of the albedo where it is white")

    @field_validator("file")
    @classmethod
    def _is_an_image(cls, file: Path) -> Path:
        from roemetry_simulate.picture_file import check_picture

        check_picture(file)
        return file


class WetPart(Part):
    """Wet places on the product: round, and glossy."""

    count: int = Field(default=0, ge=0, le=100000, description="places on a product's extent")
    diameter_mm: Sizes = Field(default=(2.0, 6.0), description="smallest and largest diameter, mm")
    gloss: Share = Field(default=0.8, description="share of mirror-like light")


class SurfacePart(Part):
    """What the product looks like."""

    albedo_laser: Share = Field(default=0.53, description="share of the laser's light that comes back")
    albedo_plain: Share = Field(default=0.62, description="share of the plain light that comes back")
    texture: Share = Field(default=0.09, description="relative deviation of the albedo (blotches and grain)")
    gloss: Share = Field(default=0.10, description="share of mirror-like light")
    gloss_exponent: float = Field(
        default=25.0, ge=1, le=10000, description="sharpness of the mirror-like light"
    )
    below: BelowPart = Field(default_factory=BelowPart, description="light below the surface")
    albedo_map: AlbedoMapPart | None = Field(
        default=None, description="a picture on the product; default: none"
    )
    wet: WetPart = Field(default_factory=WetPart, description="wet places")


class ItemPart(Part):
    """One product that was chosen, not counted up to."""

    seed: int = Field(ge=0, description="its seed")
    options: dict[str, Any] = Field(default_factory=dict, description="options set otherwise for it")


class ProductPart(Part):
    """What lies on the belt: a family of products and its options."""

    family: str = Field(default="herring-roe", description="name of a family of products, or `none`")
    options: dict[str, Any] = Field(default_factory=dict, description="the family's own options")
    items: list[ItemPart] = Field(
        default_factory=list, description="the first products, by their seeds; then seeds are counted up"
    )
    in_frame: int = Field(default=1, ge=1, le=50, description="products in one frame, side by side")
    gap_mm: float = Field(default=3.0, ge=0, le=1000, description="least gap between two of a frame, mm")
    keep_in_reach: bool = Field(
        default=True, description="move a product along X so that the stripes and the view cover it"
    )
    most_overhang_spacings: float = Field(
        default=1.2,
        ge=0,
        le=100,
        description="how far it may reach beyond the outer stripes, in their spacings",
    )

    @model_validator(mode="after")
    def _is_known(self) -> ProductPart:
        from roemetry_simulate.families import options_of

        options_of(self.family, self.options, ("options",))
        for number, item in enumerate(self.items):
            options_of(self.family, self.options | item.options, ("items", number, "options"))
        if self.items and self.in_frame > 1:
            raise MisfitError(
                (("in_frame",), "items that were chosen by seed lie alone: leave one of both out")
            )
        return self


class BlockPart(Part):
    """The calibration block as it lies on the belt."""

    length_mm: float = Field(default=105.0, gt=0, le=5000, description="side across the stripes, mm")
    width_mm: float = Field(default=40.0, gt=0, le=5000, description="side along the stripes, mm")
    height_mm: float = Field(default=16.5, gt=0, le=2000, description="height, mm")
    centre_x_mm: Place = Field(default=1.5, description="X of its middle, mm")
    centre_y_mm: Place = Field(default=-1.0, description="Y of its middle, mm")
    yaw_deg: float = Field(default=0.9, ge=-180, le=180, description="turned from belt X, degrees")


class StaircasePart(Part):
    """The staircase, at the block's place: level steps that rise along the stripes."""

    steps: int = Field(default=4, ge=1, le=20, description="number of steps")
    tread_mm: float = Field(default=15.0, gt=0, le=1000, description="extent of a step along the stripes, mm")
    riser_mm: float = Field(default=4.0, gt=0, le=500, description="height from one step to the next, mm")
    width_mm: float = Field(default=105.0, gt=0, le=5000, description="side across the stripes, mm")


class BoardPart(Part):
    """The flat boards: a ChArUco board and a chessboard in several poses."""

    columns: int = Field(default=11, ge=3, le=50, description="squares along x")
    rows: int = Field(default=8, ge=3, le=50, description="squares along y")
    square_mm: float = Field(default=8.0, gt=0.1, le=500, description="side of a square, mm")
    marker_mm: float = Field(default=6.0, gt=0.05, le=500, description="side of a ChArUco marker, mm")
    dictionary: Literal["DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250"] = Field(
        default="DICT_4X4_250", description="OpenCV's name of the markers"
    )
    poses: int = Field(default=10, ge=1, le=100, description="poses of each board")
    thickness_mm: float = Field(default=2.0, gt=0, le=100, description="of the plate, mm")
    tilt_max_deg: float = Field(default=18.0, ge=0, lt=60, description="largest tilt, degrees")
    height_mm: tuple[Place, Place] = Field(default=(0.0, 20.0), description="lowest and highest middle, mm")

    @model_validator(mode="after")
    def _fits(self) -> BoardPart:
        if self.marker_mm >= self.square_mm:
            raise MisfitError((("marker_mm",), f"must be less than square_mm, {self.square_mm:g}"))
        return self


class TargetsPart(Part):
    """What is seen for calibration."""

    block: BlockPart = Field(default_factory=BlockPart, description="the block")
    staircase: StaircasePart = Field(default_factory=StaircasePart, description="the staircase")
    board: BoardPart = Field(default_factory=BoardPart, description="the flat boards")


class RayCasterOptions(StageOptions):
    """A scene: the rig, the belt, the light, the product. The defaults are the herring roe rig."""

    camera: CameraPart = Field(default_factory=CameraPart, description="the camera")
    laser: LaserPart = Field(default_factory=LaserPart, description="the projector")
    belt: BeltPart = Field(default_factory=BeltPart, description="the belt")
    light: LightPart = Field(default_factory=LightPart, description="all other light")
    product: ProductPart = Field(default_factory=ProductPart, description="what lies on the belt")
    surface: SurfacePart = Field(default_factory=SurfacePart, description="what the product looks like")
    targets: TargetsPart = Field(default_factory=TargetsPart, description="what is seen for calibration")
    turn_deg: Literal[0, 90, 180, 270] = Field(
        default=0, description="counter-clockwise turn that rights the images, which are stored turned back"
    )
    samples: int = Field(default=4, ge=4, le=16, description="samples along each side of a pixel")

    @field_validator("camera")
    @classmethod
    def _sees_the_belt(cls, camera: CameraPart) -> CameraPart:
        from roemetry_simulate.scene_camera import check_camera

        check_camera(camera)
        return camera

    @field_validator("laser")
    @classmethod
    def _is_in_view(cls, laser: LaserPart, info: ValidationInfo) -> LaserPart:
        from roemetry_simulate.scene_camera import check_laser

        if "camera" in info.data:
            check_laser(info.data["camera"], laser)
        return laser

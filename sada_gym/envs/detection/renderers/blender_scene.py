"""The script that runs inside Blender: it reads scenes from stdin and draws them with Cycles.

`blender.py` starts it and describes the messages. It imports nothing of this package, for Blender
brings its own Python, and no NumPy, for Debian's Blender may have none. It needs Blender 3.3 or
newer, whose Python is 3.10 or newer.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import shutil
import signal
import sys
import tempfile
import traceback
from array import array
from contextlib import suppress
from typing import Any

try:
    import bpy
    from mathutils import Matrix
except ModuleNotFoundError:  # read outside Blender, as by a type checker
    bpy = None

PREFIX = "sada-gym:"
"""Every message starts with it, so that it stands out from what Blender itself prints."""

PR_SET_PDEATHSIG = 1
GROUND_HALF = 1500.0
MATT = 5
TEXTURE = "texture"
# By number of `Material`: roughness, and how much clear lacquer covers it.
FINISH = ((0.32, 0.9), (0.75, 0.0), (0.04, 0.0), (0.22, 0.0), (0.2, 0.6), (0.6, 0.0), (0.55, 0.1))


class Nodes:
    """Builds a tree of shader nodes."""

    def __init__(self, material: Any) -> None:
        material.use_nodes = True
        self.tree = material.node_tree
        self.tree.nodes.clear()

    def add(self, kind: str, **inputs: Any) -> Any:
        """Add a node of a kind; `inputs` are by name, with _ for a blank."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in inputs.items():
            self.put(node.inputs[name.replace("_", " ")], value)
        return node

    def put(self, socket: Any, value: Any) -> None:
        """Link an output to an input, or set the input to a value."""
        value = value.socket if isinstance(value, Number) else value
        if hasattr(value, "is_linked"):
            self.tree.links.new(value, socket)
        elif socket.type == "RGBA":
            socket.default_value = (*value[:3], 1.0)
        elif socket.type == "VECTOR" and isinstance(value, float):
            socket.default_value = (value, value, value)
        else:
            socket.default_value = value

    def number(self, socket: Any) -> Number:
        """Make an output a number to compute with."""
        return Number(self, socket)

    def vector(self, operation: str, *operands: Any) -> Any:
        """Apply an operation of Blender's Vector Math node to colours, vectors and numbers."""
        node = self.add("VectorMath")
        node.operation = operation
        for socket, value in zip(node.inputs, operands, strict=False):
            self.put(socket, value)
        return node.outputs[0]

    def mix(self, share: Any, a: Any, b: Any) -> Any:
        """Mix two colours, `share` of them b."""
        return self.vector("MULTIPLY_ADD", self.vector("SUBTRACT", b, a), share, a)

    def principled(self, **inputs: Any) -> Any:
        """Add a Principled BSDF, whose inputs have other names since Blender 4."""
        node = self.add("BsdfPrincipled")
        later = {"Clearcoat": "Coat Weight", "Clearcoat Roughness": "Coat Roughness"}
        later["Specular"] = "Specular IOR Level"
        for name, value in inputs.items():
            name = name.replace("_", " ")
            self.put(node.inputs[name if name in node.inputs else later[name]], value)
        return node

    def end(self, shader: Any) -> None:
        """Make a shader the material's surface."""
        self.put(self.add("OutputMaterial").inputs["Surface"], shader)


class Number:
    """A number of a shader; arithmetic with it adds Math nodes."""

    def __init__(self, nodes: Nodes, socket: Any) -> None:
        self.nodes, self.socket = nodes, socket

    def math(self, operation: str, *others: Any) -> Number:
        """Apply an operation of Blender's Math node."""
        node = self.nodes.add("Math")
        node.operation = operation
        for socket, value in zip(node.inputs, (self, *others), strict=False):
            self.nodes.put(socket, value)
        return Number(self.nodes, node.outputs[0])

    def __add__(self, other: Any) -> Number:
        """Add a number."""
        return self.math("ADD", other)

    def __sub__(self, other: Any) -> Number:
        """Subtract a number."""
        return self.math("SUBTRACT", other)

    def __mul__(self, other: Any) -> Number:
        """Multiply with a number."""
        return self.math("MULTIPLY", other)

    def __lt__(self, other: Any) -> Number:
        """Return 1 where it is less, else 0."""
        return self.math("LESS_THAN", other)

    def __gt__(self, other: Any) -> Number:
        """Return 1 where it is greater, else 0."""
        return self.math("GREATER_THAN", other)

    def floor(self) -> Number:
        """Return the largest whole number that is not larger."""
        return self.math("FLOOR")

    def fraction(self) -> Number:
        """Return what is above `floor`."""
        return self.math("FRACT")


class Stage:
    """Blender's scene: everything that stays from picture to picture."""

    def __init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.folder = tempfile.mkdtemp(prefix="sada-gym-blender-")
        for folder in (self.folder, bpy.app.tempdir):
            with suppress(OSError):
                os.rmdir(folder)
        self.models: dict[str, Any] = {}
        self.shown: list[Any] = []
        self.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self.scene.collection.objects.link(self.camera)
        self.scene.camera = self.camera
        self.sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
        self.scene.collection.objects.link(self.sun)
        self._configure()
        self._make_sky()
        self.materials = [_surface(f"material {n}", n) for n in range(len(FINISH))]
        self.painted: list[Any] = []
        self.ground = self._plane()
        self.walls, self.pole = _walls(), _pole()

    def _make_sky(self) -> None:
        world = bpy.data.worlds.new("sky")
        self.scene.world = world
        nodes = Nodes(world)
        self.sky = nodes.add("TexSky")
        kinds = [item.identifier for item in self.sky.bl_rna.properties["sky_type"].enum_items]
        # Nishita's model; Blender 5 calls it by what it computes
        self.sky.sky_type = "NISHITA" if "NISHITA" in kinds else "SINGLE_SCATTERING"
        self.sky.sun_disc = False  # a lamp of its own gives less noise
        self.haze = nodes.add("RGB")
        up = nodes.add("SeparateXYZ", Vector=nodes.add("TexCoord").outputs["Generated"]).outputs[2]
        low = (nodes.number(up).math("ABSOLUTE") * -1.0 + 1.0).math("POWER", 8.0)
        light = nodes.vector("MULTIPLY_ADD", self.haze.outputs[0], low.socket, self.sky.outputs[0])
        self.background = nodes.add("Background", Color=light)
        nodes.put(nodes.add("OutputWorld").inputs["Surface"], self.background.outputs[0])
        # paths that leave the scene find a smooth sky with less noise than rays sent there
        world.cycles.sampling_method = "NONE"

    def _configure(self) -> None:
        scene, render = self.scene, self.scene.render
        render.engine = "CYCLES"
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.max_bounces, cycles.transparent_max_bounces = 4, 12
        cycles.diffuse_bounces, cycles.glossy_bounces, cycles.transmission_bounces = 2, 3, 3
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.blur_glossy, cycles.sample_clamp_indirect = 1.0, 3.0
        cycles.use_auto_tile = False
        render.threads_mode, render.threads = "FIXED", 1
        render.use_persistent_data = True
        render.resolution_percentage = 100
        render.dither_intensity = 0.0
        render.use_compositing = render.use_sequencer = False
        render.use_file_extension = False
        render.image_settings.file_format = "PNG"
        render.image_settings.color_mode, render.image_settings.color_depth = "RGB", "8"
        render.image_settings.compression = 0
        look = "Medium High Contrast"
        _choose(scene.view_settings, "view_transform", "Filmic", "AgX")
        _choose(scene.view_settings, "look", look, f"Filmic - {look}", f"AgX - {look}")

    def _plane(self) -> Any:
        half = GROUND_HALF
        mesh = bpy.data.meshes.new("ground")
        corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
        plane = bpy.data.objects.new("ground", mesh)
        self.scene.collection.objects.link(plane)
        return plane

    def draw(self, order: dict[str, Any]) -> bytes:
        """Draw the scene of an order; return a PNG file."""
        self._place_camera(order["camera"])
        self._light(order["sun"])
        self._paint(order["materials"])
        for shown in self.shown:
            self.scene.collection.objects.unlink(shown)
        self.shown = [self._buildings(order["backdrop"]["buildings"])]
        if order["shape"] is not None:
            self.shown.append(self.models[order["shape"]])
        if order["pole"] is not None:
            self.shown.append(self.pole)
            self.pole.matrix_world = _matrix(order["pole"]["axes"], order["pole"]["middle"])
            _colour(self.pole.data.materials[0], order["pole"]["colour"])
        for shown in self.shown:
            self.scene.collection.objects.link(shown)
        self._lay_ground(order["backdrop"])
        render = self.scene.render
        render.resolution_x = render.resolution_y = order["size"]
        self.scene.cycles.samples, self.scene.cycles.seed = order["samples"], order["seed"]
        # a folder for the moment only: nobody cleans up after a process that is killed
        os.mkdir(self.folder, 0o700)
        render.filepath = os.path.join(self.folder, "picture.png")
        try:
            bpy.ops.render.render(write_still=True)
            with open(render.filepath, "rb") as file:
                picture = file.read()
        finally:
            shutil.rmtree(self.folder)
        return picture

    def _place_camera(self, placed: dict[str, Any]) -> None:
        lens = self.camera.data
        lens.angle = placed["angle"]
        lens.shift_x, lens.shift_y = placed["shift"]
        lens.clip_start, lens.clip_end = 0.05, 4 * GROUND_HALF
        self.camera.matrix_world = _matrix(placed["axes"], placed["eye"])

    def _light(self, sun: dict[str, Any]) -> None:
        sky, lamp = self.sky, self.sun.data
        azimuth, pitch = sun["azimuth"], sun["pitch"]
        sky.sun_elevation, sky.sun_rotation = pitch, math.pi / 2 - azimuth
        sky.dust_density, sky.air_density, sky.ozone_density = sun["dust"], 1.0, 2.0
        self.background.inputs["Strength"].default_value = sun["sky"]
        self.haze.outputs[0].default_value = (*sun["haze"], 1.0)
        lamp.energy, lamp.angle = 1.0, sun["angle"]
        lamp.color = sun["colour"]
        self.sun.rotation_euler = (0.0, math.pi / 2 - pitch, azimuth)  # its beam runs along -z

    def _paint(self, rows: list[list[float]]) -> None:
        for material, row in zip(self.materials, rows, strict=True):
            _colour(material, row)
        for material in self.painted:
            _colour(material, rows[0][:3])

    def _lay_ground(self, backdrop: dict[str, Any]) -> None:
        # made anew: a picture must not depend on those before it
        slots = self.ground.data.materials
        old = slots[0] if slots else None
        slots.clear()
        if old is not None:
            bpy.data.materials.remove(old)
        slots.append(_ground(backdrop))

    def _buildings(self, boxes: list[list[float]]) -> Any:
        old = bpy.data.objects.get("buildings")
        if old is not None:
            bpy.data.meshes.remove(old.data)  # and the object with it
        mesh = bpy.data.meshes.new("buildings")
        corners: list[Any] = []
        faces, colours, windows = [], [], []
        for x, y, half_x, half_y, height, red, green, blue, pitch, storey in boxes:
            first = len(corners)
            plan = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
            corners += [(x + a, y + b, z) for z in (0.0, height) for a, b in plan]
            for side in range(4):
                following = (side + 1) % 4
                faces.append([first + i for i in (side, following, following + 4, side + 4)])
                # windows are counted from the wall's middle
                half = (half_x if side % 2 == 0 else half_y) / pitch
                top = height / storey
                windows += [(-half, 0), (half, 0), (half, top), (-half, top)]
            faces.append([first + i for i in (4, 5, 6, 7)])
            windows += [(0.9, 0.1)] * 4  # a roof has none
            colours += [(red, green, blue, 1.0)] * 20
        mesh.from_pydata(corners, [], faces)
        mesh.uv_layers.new(name="windows").data.foreach_set("uv", _flat(windows))
        attribute = mesh.color_attributes.new("colour", "FLOAT_COLOR", "CORNER")
        attribute.data.foreach_set("color", _flat(colours))
        mesh.materials.append(self.walls)
        buildings = bpy.data.objects.new("buildings", mesh)
        buildings.visible_shadow = False  # a low sun shines on every square, as in the rasteriser
        return buildings

    def add_model(self, key: str, surfaces: list[dict[str, Any]], arrays: dict[str, Any]) -> None:
        """Keep a mesh by its key; without surfaces it is made of the usual materials."""
        mesh = bpy.data.meshes.new(key)
        corners, normals = arrays["faces"], arrays["normals"]
        mesh.vertices.add(len(arrays["vertices"]) // 3)
        mesh.vertices.foreach_set("co", arrays["vertices"])
        mesh.loops.add(len(corners))
        mesh.loops.foreach_set("vertex_index", corners)
        starts = array("i", range(0, len(corners), 3))
        mesh.polygons.add(len(starts))
        mesh.polygons.foreach_set("loop_start", starts)
        if bpy.app.version < (4, 1):
            mesh.polygons.foreach_set("loop_total", array("i", [3]) * len(starts))
        mesh.polygons.foreach_set("use_smooth", array("b", [1]) * len(starts))
        for material in self._surfaces(key, surfaces, arrays) or self.materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", arrays["materials"])
        mesh.update(calc_edges=True)
        if hasattr(mesh, "use_auto_smooth"):  # before Blender 4.1
            mesh.use_auto_smooth = True
        vectors = zip(normals[0::3], normals[1::3], normals[2::3], strict=True)
        mesh.normals_split_custom_set_from_vertices(list(vectors))
        if "uv" in arrays:
            uv = arrays["uv"]
            places = [uv[i] for corner in corners for i in (2 * corner, 2 * corner + 1)]
            mesh.uv_layers.new(name=TEXTURE).data.foreach_set("uv", array("f", places))
        self.models[key] = bpy.data.objects.new(key, mesh)

    def _surfaces(self, key: str, surfaces: list[dict[str, Any]], arrays: dict[str, Any]) -> Any:
        made = []
        for number, plain in enumerate(surfaces):
            name, image = f"{key} {number}", None
            if plain["texture"] is not None:
                image = bpy.data.images.new(name, *plain["texture"], alpha=True)
                image.alpha_mode = "CHANNEL_PACKED"
                image.pixels.foreach_set(arrays[f"texture {number}"])
                image.update()
            material = _surface(name, plain["material"], plain["opacity"], image)
            _colour(material, plain["colour"])
            if plain["painted"]:
                self.painted.append(material)
            made.append(material)
        return made


def _matrix(axes: list[list[float]], origin: list[float]) -> Any:
    """Return the transformation to a frame with three axes, x, y and z, at an origin."""
    return Matrix((*zip(*axes, origin, strict=True), (0, 0, 0, 1)))


def _pole() -> Any:
    """Make a pole of radius 1 along y, from -1 to 1, which throws no shadow and no light."""
    sides = 64
    turns = [2 * math.pi * i / sides for i in range(sides)]
    corners = [(math.cos(turn), y, math.sin(turn)) for y in (-1.0, 1.0) for turn in turns]
    faces = [(i, i + sides, (i + 1) % sides + sides, (i + 1) % sides) for i in range(sides)]
    mesh = bpy.data.meshes.new("pole")
    mesh.from_pydata(corners, [], faces)
    mesh.polygons.foreach_set("use_smooth", array("b", [1]) * sides)
    mesh.materials.append(_surface("pole", MATT))
    pole = bpy.data.objects.new("pole", mesh)
    pole.visible_shadow = pole.visible_diffuse = pole.visible_glossy = False
    return pole


def _surface(name: str, kind: int, opacity: float = 1.0, image: Any = None) -> Any:
    """Make a material that has the finish of a `Material`; `_colour` gives it its colour."""
    material = bpy.data.materials.new(name)
    nodes = Nodes(material)
    paint = nodes.add("RGB")
    alpha: Any = opacity
    paint.name = "colour"
    colour = paint.outputs[0]
    if image is not None:
        plan = nodes.add("UVMap")
        plan.uv_map = TEXTURE
        texture = nodes.add("TexImage", Vector=plan.outputs[0])
        texture.image = image
        colour = nodes.vector("MULTIPLY", colour, texture.outputs["Color"])
        alpha = (nodes.number(texture.outputs["Alpha"]) > 0.5) * opacity
    roughness, lacquer = FINISH[kind]
    surface = nodes.principled(
        Base_Color=colour,
        Roughness=roughness,
        Clearcoat=lacquer,
        Clearcoat_Roughness=0.03,
        Specular=0.5,
        Alpha=alpha,
    )
    surface.name = "surface"
    nodes.end(surface.outputs[0])
    return material


def _colour(material: Any, row: list[float]) -> None:
    """Set a material's linear colour and, if a fourth number is given, its share of metal."""
    nodes = material.node_tree.nodes
    nodes["colour"].outputs[0].default_value = (*row[:3], 1.0)
    if len(row) > 3:
        nodes["surface"].inputs["Metallic"].default_value = row[3]


def _ground(backdrop: dict[str, Any]) -> Any:
    """Make the ground's material: asphalt, paving, brick, grass or concrete, by its number."""
    material = bpy.data.materials.new("ground")
    nodes = Nodes(material)
    place = nodes.add("SeparateXYZ", Vector=nodes.add("NewGeometry").outputs["Position"])
    x, y = nodes.number(place.outputs["X"]), nodes.number(place.outputs["Y"])
    cosine, sine = backdrop["ground_turn"]
    u = x * cosine - y * sine + backdrop["ground_shift"][0]
    v = x * sine + y * cosine + backdrop["ground_shift"][1]
    at = nodes.add("CombineXYZ", X=u, Y=v).outputs[0]

    def noise(scale: float, detail: float) -> Number:
        node = nodes.add("TexNoise", Vector=at, Scale=scale, Detail=detail)
        return nodes.number(node.outputs[0]) - 0.5

    fine, coarse = noise(16.0, 3.0), noise(0.55, 3.0)
    shade = fine * 0.9 + coarse * 0.9 + 1.0
    kind, line = backdrop["ground"], None
    if kind == 0:  # asphalt: a dashed marking every 9 units
        shade = shade + noise(70.0, 1.0) * 0.9
        across = (u * (1 / 9.0) + 0.5).fraction() - 0.5
        line = (across.math("ABSOLUTE") < 0.01) * ((v * (1 / 3.0)).fraction() < 0.6)
        line = line * 0.85
    elif kind == 3:  # grass
        blades = nodes.add("TexNoise", Vector=at, Scale=45.0, Detail=4.0).outputs[0]
        shade = shade + (nodes.number(blades) - 0.5) * 2.6 + noise(0.15, 2.0) * 0.9
    else:  # paving stones, brick in running bond, concrete slabs
        brick = kind == 2
        size = backdrop["tile"] * {1: 1.0, 2: 0.7, 4: 2.6}[kind]
        row = v * ((2.0 if brick else 1.0) / size)
        shift = (row.floor() * 0.5).fraction() if brick else 0.0
        column = u * (1 / size) + shift
        joint = 0.05 / size
        inside = (column.fraction() > joint) * (row.fraction() > (2 * joint if brick else joint))
        line = (inside * -1.0 + 1.0) * 0.75
        cell = nodes.add("CombineXYZ", X=column.floor(), Y=row.floor()).outputs[0]
        stone = nodes.number(nodes.add("TexWhiteNoise", Vector=cell).outputs[0]) - 0.5
        shade = shade + stone * 0.35
    colour = nodes.vector("MULTIPLY", backdrop["ground_colour"], shade.math("MAXIMUM", 0.2))
    if line is not None:
        colour = nodes.mix(line, colour, backdrop["joint_colour"])
    wet = backdrop["gloss"]
    roughness = (coarse * 1.2 - wet * 0.9 + 0.85).math("MAXIMUM", 0.12)
    height = fine if line is None else fine - line * 1.5
    bump = nodes.add("Bump", Strength=0.35, Distance=0.03, Height=height).outputs[0]
    surface = nodes.principled(
        Base_Color=colour, Roughness=roughness, Specular=0.3 + 0.3 * wet, Normal=bump
    )
    nodes.end(surface.outputs[0])
    return material


def _walls() -> Any:
    """Make the material of all walls: their colour, and windows in front of a dark room."""
    material = bpy.data.materials.new("walls")
    nodes = Nodes(material)
    plan = nodes.add("UVMap")
    plan.uv_map = "windows"
    place = nodes.add("SeparateXYZ", Vector=plan.outputs[0])
    column = (nodes.number(place.outputs["X"]) + 0.25).fraction()
    storey = nodes.number(place.outputs["Y"]).fraction()
    window = (column < 0.5) * (storey > 0.3) * (storey < 0.8)
    wall = nodes.add("Attribute")
    wall.attribute_name = "colour"
    dirt = nodes.add("TexNoise", Scale=1.3, Detail=5.0)
    nodes.put(dirt.inputs["Vector"], nodes.add("NewGeometry").outputs["Position"])
    plaster = nodes.vector(
        "MULTIPLY", wall.outputs["Color"], nodes.number(dirt.outputs[0]) * 0.6 + 0.7
    )
    surface = nodes.principled(
        Base_Color=nodes.mix(window, plaster, (0.03, 0.04, 0.05)),
        Roughness=window * -0.77 + 0.85,
        Specular=window * 0.6 + 0.2,
    )
    nodes.end(surface.outputs[0])
    return material


def _send(channel: Any, **message: Any) -> None:
    channel.write(f"{PREFIX}{json.dumps(message)}\n".encode())
    channel.flush()


def _choose(owner: Any, name: str, *values: str) -> None:
    """Set a choice to the first of some values that this version of Blender has."""
    for value in values:
        try:
            setattr(owner, name, value)
        except TypeError:
            continue
        return


def _flat(rows: list[Any]) -> Any:
    return array("f", [number for row in rows for number in row])


def _read(stream: Any, kind: str, count: int) -> Any:
    """Read numbers of a type: f a float of 32 bits, i an integer of 32 bits, B a byte."""
    numbers = array(kind)
    numbers.frombytes(stream.read(numbers.itemsize * count))
    return numbers


def serve() -> None:
    """Answer orders until stdin ends."""
    # messages leave by a copy of stdout; whatever Blender prints goes to stderr from now on
    channel = os.fdopen(os.dup(1), "wb")
    sys.stdout.flush()
    os.dup2(2, 1)
    stdin = sys.stdin.buffer
    try:
        stage = Stage()
    except Exception as error:  # such as a build without Cycles
        _send(channel, error=f"{type(error).__name__}: {error}")
        return
    _send(channel, folder=stage.folder)
    while line := stdin.readline():
        order = json.loads(line)
        arrays = {name: _read(stdin, *rest) for name, *rest in order.pop("arrays", [])}
        try:
            if "model" in order:
                stage.add_model(order["model"], order["surfaces"], arrays)
                picture = b""
            else:
                picture = stage.draw(order)
        except Exception as error:  # told to the other side, which knows what it was about
            traceback.print_exc()
            _send(channel, error=f"{type(error).__name__}: {error}".strip())
        else:
            _send(channel, bytes=len(picture))
            channel.write(picture)
            channel.flush()


if __name__ == "__main__":
    if "--die-with-parent" in sys.argv and sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    serve()

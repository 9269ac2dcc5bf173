"""Light at surfaces and from environments: samples agree with densities, and these with formulas and integrals.

The light that pictures get so, by formula: `tests/image/`.
"""

import numpy as np
import pytest

import clbvh
from clbvh.layouts.pack_normals import pack_normals
from clbvh.rendering.environment_tables import find_axes, make_environment_tables
from clbvh.rendering.look_tables import TextureTables
from clbvh.structs import VIEW

pytestmark = pytest.mark.on_both

GRID = 256
COSINES = (1.0, 0.8, 0.3, 0.05)
MATERIAL = {"base_colour": (1, 1, 1), "metallic": 0, "roughness": 0.5, "ior": 1.5, "transmission": 0, "back": 0}

SCATTER = """
    appearance_t look;
    look.base_colour = material.s012;
    look.metallic = material.s3; look.roughness = material.s4; look.ior = material.s5; look.transmission = material.s6;
    const bsdf_t bsdf = make_bsdf(&look, material.s7 != 0.0f, eye);
    scattered_t scattered;
    float density = 0.0f;
    if (sample_bsdf(&bsdf, eye, sample.x, sample.yz, &scattered)) {
        drawn = (float8)(scattered.direction, scattered.weight, scattered.density, scattered.is_below ? 2.0f : 1.0f);
        const float3 value = evaluate_bsdf(&bsdf, eye, scattered.direction, &density);
        at_drawn = (float4)(value, density);
    }
    const float3 value = evaluate_bsdf(&bsdf, eye, light, &density);
    at_light = (float4)(value, density);
"""


@pytest.fixture
def scatter(call):
    """A function from an eye's cosine, samples, directions to evaluate and a material to what is drawn and evaluated.

    That is, drawn: direction, weight, density, and 0 for none, 1 above, 2 below the surface; then value and density
    there, and value and density in the given directions.
    """

    def run(cosine, samples=((0, 0, 0),), to_light=((0, 0, 1),), **material):
        rows = {
            "material": np.hstack([*(MATERIAL | material).values()])[None],
            "eye": [[np.sqrt(1 - cosine**2), 0, cosine]],
            "sample": np.asarray(samples, float),
            "light": np.asarray(to_light, float),
        }
        found = call("film/bsdf.cl", SCATTER, "float8 drawn, float4 at_drawn, float4 at_light", **rows)
        return [values.astype(np.float64) for values in found]

    return run


@pytest.fixture(scope="module")
def samples():
    """(GRID^2, 3): a lobe and a point of the square each; the lobes are in every part of the square."""
    generator = np.random.default_rng(7)
    cells = np.stack(np.meshgrid(np.arange(GRID), np.arange(GRID)), axis=-1).reshape(-1, 2)
    return np.hstack([generator.random((GRID**2, 1)), (cells + generator.random((GRID**2, 2))) / GRID])


@pytest.mark.parametrize("metallic", [0, 0.5, 1])
def test_weight_times_density_is_the_value(scatter, samples, metallic):
    for cosine in COSINES:
        for roughness in (0.05, 0.3, 1.0):  # 0.05 is a highlight of a fifth of a degree
            material = {"metallic": metallic, "roughness": roughness, "base_colour": (0.9, 0.5, 0.1)}
            drawn, at_drawn, _ = scatter(cosine, samples[::16], **material)
            assert (drawn[:, 7] > 0).sum() > 100
            np.testing.assert_allclose(drawn[:, 6], at_drawn[:, 3], rtol=1e-6)
            np.testing.assert_allclose(drawn[:, 3:6] * drawn[:, 6:7], at_drawn[:, :3], rtol=1e-5, atol=1e-30)


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("back", [0, 1])
def test_glass_keeps_energy(scatter, samples, back, cosine):
    """A smooth boundary loses nothing; a rough one what facets hide."""
    for roughness in (0.05, 0.5, 1):
        drawn, *_ = scatter(cosine, samples, transmission=1, roughness=roughness, back=back)
        assert drawn[:, 3].mean() <= 1 + 2e-3
    drawn, *_ = scatter(cosine, samples, transmission=1, roughness=0, back=back)
    np.testing.assert_allclose(drawn[:, 3], 1, rtol=1e-4)
    # Snell's law, and Fresnel's share of the samples.
    ratio = 1 / 1.5 if back else 1.5
    sine = np.sqrt(1 - cosine**2) / ratio
    below = drawn[drawn[:, 7] == 2]
    if sine > 1:
        assert len(below) == 0
        return
    inner = np.sqrt(1 - sine**2)
    np.testing.assert_allclose(below[:, :3], np.tile([-sine, 0, -inner], (len(below), 1)), atol=2e-6)
    parallel = (ratio * cosine - inner) / (ratio * cosine + inner)
    across = (cosine - ratio * inner) / (cosine + ratio * inner)
    assert abs(1 - len(below) / len(drawn) - (parallel**2 + across**2) / 2) < 6e-3


def test_narrow_highlights_keep_their_density(scatter):
    """The GGX distribution at its centre and flanks, to float32's precision, for nearly smooth surfaces."""
    alpha = 0.04**2
    tangent = alpha * np.array([0, 0.25, 1, 4, 20])
    facet = np.column_stack([tangent, 0 * tangent, np.ones(5)]) / np.sqrt(1 + tangent**2)[:, None]
    _, _, values = scatter(1.0, to_light=2 * facet[:, 2:] * facet - [0, 0, 1], metallic=1, roughness=0.04)
    expected = alpha**2 / (np.pi * facet[:, 2] ** 4 * (alpha**2 + tangent**2) ** 2) / 4
    np.testing.assert_allclose(values[:, 0], expected, rtol=2e-3)


UP = np.array([0.0, 1.0, 0.0])


def make_map(height, width):
    return (np.random.default_rng(0).random((height, width, 3)) ** 8).astype(np.float32)


def direction_of(column, row, width, height, rotation):
    """The unit vector of a place in the map, in pixels, by the stated convention."""
    front, right = find_axes(UP, rotation)
    longitude, latitude = 2 * np.pi * (np.asarray(column) / width - 0.5), np.pi * np.asarray(row) / height
    around = np.sin(longitude)[..., None] * right + np.cos(longitude)[..., None] * front
    return np.sin(latitude)[..., None] * around + np.cos(latitude)[..., None] * UP


def look(call, pixels, directions, **settings):
    """The light of an environment from given directions."""
    view = np.zeros(1, VIEW)
    view["to_sky"] = view["to_light"] = UP
    tables = make_environment_tables(pixels)
    tables.describe(view, clbvh.View(**settings))
    body = """
        const lights_t lights = {0, 0, environment, environment_rows, environment_columns};
        light = environment_light(&lights, view, direction);
    """
    given = {"tables": {"view": view, **tables.arrays}, "defines": {"HAS_CUTOUTS": 0, "SHADING": 6}}
    return call("film/lights.cl", body, "float3 light", direction=directions, **given).astype(np.float64)


@pytest.mark.parametrize("rotation", [0, 90, -30, 1000])
def test_light_is_interpolated_between_the_centres_of_pixels(call, rotation):
    pixels = make_map(8, 16)
    columns, rows = (places.ravel() + 0.5 for places in np.meshgrid(np.arange(16), np.arange(8)))
    given = direction_of(columns, rows, 16, 8, rotation)
    found = look(call, pixels, given, environment_rotation=rotation, environment_strength=3.0)
    np.testing.assert_allclose(found, 3 * pixels.reshape(-1, 3), atol=2e-5)
    # Halfway, also over the seam behind.
    given = direction_of(columns + 0.5, rows, 16, 8, rotation)
    means = (pixels + np.roll(pixels, -1, axis=1)) / 2
    found = look(call, pixels, given, environment_rotation=rotation)
    np.testing.assert_allclose(found, means.reshape(-1, 3), atol=2e-5)


def test_packed_normals_come_back(call):
    signs = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    normals = np.concatenate((signs[np.abs(signs).sum(axis=1) > 0], np.random.default_rng(3).normal(size=(5000, 3))))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    packed = pack_normals(normals.astype(np.float32))
    decoded = call("looks/looks.cl", "normal = decode_normal(packed);", "float3 normal", packed=packed)
    np.testing.assert_allclose(np.linalg.norm(decoded, axis=1), 1, rtol=0, atol=2e-7)
    sines = np.linalg.norm(np.cross(decoded.astype(float), normals), axis=1)
    # Of the octahedral map with 16 bits a side; axes are exact.
    assert np.degrees(sines).max() < 0.0045
    assert (np.einsum("ij,ij->i", decoded, normals) > 0).all()
    is_axis = np.abs(normals).max(axis=1) == 1
    np.testing.assert_array_equal(decoded[is_axis], normals[is_axis])


# The texels of a texture of one row, and those around it by the rules of its edges.
ROW = [10, 60, 110, 160]
AROUND = {
    "repeat": [*ROW, *ROW, *ROW],
    "clamp": [*[10] * 4, *ROW, *[160] * 4],
    "mirror": [*ROW[::-1], *ROW, *ROW[::-1]],
}


def read(call, pixels, uvs, wrap, **options):
    """Colours of a texture, (n, 4)."""
    tables = TextureTables()
    number = tables.number(clbvh.Texture("row", pixels, is_srgb=False, wrap=(wrap, wrap), **options))
    body = f"""
        const texture_tables_t tables = {{textures, texels, decoded_srgb}};
        colour = sample_texture(&tables, {number}, uv);
    """
    return call("looks/texture.cl", body, "float4 colour", uv=uvs, tables=tables.arrays())


@pytest.mark.parametrize("wrap", AROUND)
def test_textures_go_on_beyond_their_edges(call, wrap):
    # Centres of texels and points between them, from one size before the texture to one behind it.
    places = np.arange(-3.5, 7.01, 0.25)
    expected = np.interp(places, np.arange(-4, 8) + 0.5, AROUND[wrap]) / 255
    across, along = np.full(len(places), 0.5), places / len(ROW)
    row = np.full((1, len(ROW), 4), 255, np.uint8)
    row[..., :3] = np.array(ROW)[:, None]
    colours = read(call, row, np.stack((along, across), axis=1), wrap)
    np.testing.assert_allclose(colours, np.stack([*[expected] * 3, np.ones(len(places))], axis=1), rtol=0, atol=1e-6)
    # Row 0 is the top.
    colours = read(call, row.transpose(1, 0, 2)[::-1], np.stack((across, along), axis=1), wrap)
    np.testing.assert_allclose(colours[:, 0], expected, rtol=0, atol=1e-6)
    # Texels that are squares, up to next to their edges.
    places = (np.arange(-4, 8)[:, None] + [0.001, 0.5, 0.999]).ravel()
    expected, along, across = np.repeat(AROUND[wrap], 3), places / len(ROW), np.full(len(places), 0.3)
    for pixels, uvs in ((row, (along, across)), (row.transpose(1, 0, 2)[::-1], (across, along))):
        colours = read(call, pixels, np.stack(uvs, axis=1), wrap, filter="nearest")
        np.testing.assert_array_equal(np.rint(colours[:, 0] * 255), expected)

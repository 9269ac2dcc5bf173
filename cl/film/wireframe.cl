// Lines along the edges of triangles, drawn over what a ray of the camera shows.
//
// HAS_WIREFRAME, if defined as 1: the picture may have lines, see clbvh/views/settings.py; their width tells.
//
// The edge function of a ray and an edge is linear in the ray. Divided by its change from one pixel to the next it is
// the distance to the line of the edge, in pixels: exactly in a perspective and in an orthographic picture.

#include "rays/camera.cl"
#include "world/surface.cl"

#if HAS_WIREFRAME

// Where an edge is seen at most this many widths of its line from the opposite corner, the line is not drawn, and from
// the second number on in full: lines closer to each other would become one dark surface.
#define NO_LINE_WIDTHS 1.5f
#define FULL_LINE_WIDTHS 6.0f

// The change of a ray by a step in the picture. That of the direction is in lengths of the direction, and may change
// its length.
typedef struct {
    float3 origin;
    float3 direction;
} ray_step_t;

CALLED ray_step_t find_ray_step(
    const global view_t *view, const float2 film, const float2 step, const float3 direction)
{
    const float3 on_film = step.x * load3(view->right) + step.y * load3(view->up);
    // Perspective and parallel rays have depth 1 before they are normalized.
    const float to_unit = dot_product(direction, load3(view->optical_axis));
    ray_step_t change = {(float3)(0.0f), to_unit * on_film};
    if (view->projection == PROJECTION_ORTHOGRAPHIC) {
        change.origin = on_film;
        change.direction = (float3)(0.0f);
    } else if (view->projection == PROJECTION_DISTORTED) {
        const float2 moved = undistorted_point(view, film + step) - undistorted_point(view, film);
        change.direction = to_unit * (moved.x * load3(view->right) + moved.y * load3(view->up));
    } else if (view->projection != PROJECTION_PERSPECTIVE) {
        float3 moved;
        wide_direction(view, film + step, &moved);
        change.direction = moved - direction;
    }
    return change;
}

// The share of a pixel that a line covers. `smoothing` is the width in pixels over which the line's sides are smooth.
INLINED float find_edge_share(const float distance, const float height, const float width, const float smoothing)
{
    const float covered = 0.5f * (width + smoothing) - distance;
    const float share = clamp(covered, 0.0f, smaller(width, smoothing)) / smoothing;
    const float least = larger(width, 1.0f);
    const float strength = (height / least - NO_LINE_WIDTHS) / (FULL_LINE_WIDTHS - NO_LINE_WIDTHS);
    return share * clamp(strength, 0.0f, 1.0f);
}

// The share of a pixel, from 0 to 1, that lines cover around a ray's hit at `position`; 0 for primitives without edges.
CALLED float find_line_share(
    const global view_t *view, const world_t *world, const world_ray_t *ray, const float2 film,
    const search_t *search, const float3 position, const float smoothing)
{
    if (!(view->line_width > 0.0f) || !IS_TRIANGLES(hit_kind(world, search))) {
        return 0.0f;
    }
    float3 ab, ac;
    world_edges(world, search, &ab, &ac);
    // Products of the edges of a tiny or huge triangle would leave float32.
    const float scale = unit_scale(magnitude(ab) + magnitude(ac));
    ab *= scale;
    ac *= scale;
    const float3 normal = cross_product(ab, ac);
    const float3 direction = ray->direction;
    const float facing = absolute(dot_product(direction, normal));
    const float t = dot_product(position - ray->origin, direction);

    const float3 edges[3] = {ac - ab, -ac, ab};
    const float u = search->nearest.u;
    const float v = search->nearest.v;
    const float shares[3] = {1.0f - u - v, u, v};
    const ray_step_t right = find_ray_step(view, film, (float2)(2.0f / view->width, 0.0f), direction);
    const ray_step_t up = find_ray_step(view, film, (float2)(0.0f, 2.0f / view->height), direction);
    // The ways of the hit along the steps; edges are scaled, and so are these.
    const float3 way_right = scale * (right.origin + t * right.direction);
    const float3 way_up = scale * (up.origin + t * up.direction);

    float covered = 0.0f;
    for (int i = 0; i < 3; i++) {
        const float3 across = cross_product(direction, edges[i]);
        const float x = shares[i] * dot_product(right.direction, normal) + dot_product(way_right, across);
        const float y = shares[i] * dot_product(up.direction, normal) + dot_product(way_up, across);
        const float height = facing / sqrt(x * x + y * y);
        // Not a number for a triangle without area.
        if (height > 0.0f) {
            const float distance = absolute(shares[i]) * height;
            covered = larger(covered, find_edge_share(distance, height, view->line_width, smoothing));
        }
    }
    return covered;
}

#endif

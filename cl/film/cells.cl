// The rays of cells: the square of each pixel, whose samples count for the 3 x 3 pixels around it by the tent filter.
// So a pixel has the samples of nine cells, and the noise of about twice as many samples that are drawn by the filter
// and count for it alone. kernels/add_samples.cl makes pixels of them.
//
// All cells have the same pattern of samples, so the weights of a pixel's samples add up to their number, and edges
// have no noise. Sample 0 is the centre of the pixel.
//
// Cell (column, row) belongs to the pixel (column - 1, row - 1): there are cells around the picture, too.

#include "film/pixel.cl"
#include "world/camera.cl"

// Whether samples at an offset count for any pixel, in one direction, of the picture; the first cell is before it.
INLINED bool counts(const int cell, const float offset, const int pixel_count)
{
    return cell == 0 ? offset > 0.0f : cell <= pixel_count || offset < 0.0f;
}

// The ray of a sample. Returns whether the camera sees anything there, and the picture shows it.
INLINED bool sample_cell(
    const global view_t *view, const int column, const int row, const float2 offset, const uint sample,
    world_ray_t *ray)
{
    if (!counts(column, offset.x, view->width) || !counts(row, offset.y, view->height)) {
        return false;
    }
    const int number = row * (view->width + 2) + column;
    const float2 lens = view->has_lens ? sample_lens(view, number, sample) : LENS_CENTRE;
    return world_camera_ray(view, film_point(view, column - 1, row - 1, offset), lens, ray);
}

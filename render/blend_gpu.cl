// Stage: blend, GPU shape. One work-group draws one tile, one work-item one pixel.
//   in   tile_start, intersection_splat, splats
//   out  color [3][h][w] with background, transmit [h][w]; where the view has a unit of depth also
//        moment_maps [2][h][w], see blend_cpu.cl (else it is not touched); known [h][w] is read
//        where it has a known_zeta
// Splats come in batches of 256: each work-item fetches one record into local memory (12 KiB), then
// all walk the batch. The group leaves when every pixel has stopped. Three barriers a batch,
// reached by all. Same maths and order per pixel as blend_cpu.cl; only the skipping of blocks is
// missing. Reference: render_ref_forward.

struct blend_record { // what blending takes from struct layout_splat
    float mean_x, mean_y, p, x_of_y, r, opacity_log2, red, green, blue, depth, tilt_x, tilt_y;
};

__kernel __attribute__((reqd_work_group_size(LAYOUT_TILE_PIXELS, 1, 1))) void
blend(__constant struct layout_view *view, __global const struct layout_splat *splats,
      __global const uint *tile_start, __global const uint *intersection_splat,
      __global float *color, __global float *transmit, __global ushort *hits,
      __global uint *tile_stop, __global float *moment_maps, __global const float *known)
{
    __local struct blend_record staged[LAYOUT_TILE_PIXELS];
    __local uint alive;
    uint tile = (uint)get_group_id(0), item = (uint)get_local_id(0);
    uint x = (tile % view->tiles_x) * LAYOUT_TILE + item % LAYOUT_TILE;
    uint y = (tile / view->tiles_x) * LAYOUT_TILE + item / LAYOUT_TILE;
    uint end = tile_start[tile + 1];
    bool inside = x < view->width && y < view->height;
    float px = (float)x + 0.5f, py = (float)y + 0.5f;
    float t = inside ? 1.0f : 0.0f, red = 0.0f, green = 0.0f, blue = 0.0f, m1 = 0.0f, m2 = 0.0f;
    float scale = 0.0f, shift = 0.0f;
    const bool moments = view->depth_unit_m > 0.0f, about = view->known_zeta > 0.0f;
    if (about && inside)
        ray_known(view, known[(size_t)y * view->width + x], &scale, &shift);

    for (uint at = tile_start[tile]; at < end; at += LAYOUT_TILE_PIXELS) {
        if (item == 0)
            alive = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (t > LAYOUT_TRANSMITTANCE_MIN)
            atomic_or(&alive, 1u);
        if (at + item < end) {
            __global const struct layout_splat *s = splats + intersection_splat[at + item];
            staged[item].mean_x = s->mean_x;
            staged[item].mean_y = s->mean_y;
            staged[item].p = s->p;
            staged[item].x_of_y = s->x_of_y;
            staged[item].r = s->r;
            staged[item].opacity_log2 = s->opacity_log2;
            staged[item].red = s->rgb[0];
            staged[item].green = s->rgb[1];
            staged[item].blue = s->rgb[2];
            staged[item].depth = as_float(s->cover);
            staged[item].tilt_x = as_float(s->bands[0]);
            staged[item].tilt_y = as_float(s->bands[1]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (!alive)
            break;
        uint n = min(end - at, (uint)LAYOUT_TILE_PIXELS);
        for (uint j = 0; j < n && t > LAYOUT_TRANSMITTANCE_MIN; j++) {
            __local const struct blend_record *w = staged + j;
            float dx = w->mean_x - px, dy = w->mean_y - py;
            float a = splat_raw(dx, dy, w->p, w->x_of_y, w->r, w->opacity_log2);
            a = MIN_(a, LAYOUT_ALPHA_MAX);
            float share = a * t;
            t = t - share;
            red = share * w->red + red;
            green = share * w->green + green;
            blue = share * w->blue + blue;
            if (moments) {
                float m = w->tilt_x * dx + (w->tilt_y * dy + w->depth), value[2], slope[2];
                ray_values(m, scale, shift, about, value, slope);
                m1 = share * value[0] + m1;
                m2 = share * value[1] + m2;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE); // nobody still reads staged or alive
    }
    if (inside) {
        size_t plane = (size_t)view->width * view->height, at = (size_t)y * view->width + x;
        color[at] = t * view->background[0] + red;
        color[plane + at] = t * view->background[1] + green;
        color[2 * plane + at] = t * view->background[2] + blue;
        transmit[at] = t;
        if (moments) {
            moment_maps[at] = m1;
            moment_maps[plane + at] = m2;
        }
    }
}

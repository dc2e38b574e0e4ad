// Stage: another background behind some pixels, after blend.
//   in   where [h][w]: 0 where the background stays; red, green, blue: difference of the other
//        background; transmit [h][w]
//   out  color [3][h][w]: plus the difference times transmit
// The backward pass uses the resulting picture, so it does not need this stage.
__kernel void background(__constant struct layout_view *view, float red, float green, float blue,
                         __global const uchar *where, __global const float *transmit,
                         __global float *color)
{
    size_t at = get_global_id(0), plane = (size_t)view->width * view->height;
    if (at >= plane || !where[at])
        return;
    float t = transmit[at];
    color[at] = t * red + color[at];
    color[plane + at] = t * green + color[plane + at];
    color[2 * plane + at] = t * blue + color[2 * plane + at];
}

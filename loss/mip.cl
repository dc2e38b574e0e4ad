// The 3-D filter of Mip-Splatting: sigma f_i = sqrt(0.2) min z_i / f_max over the cameras that see
// Gaussian i (z > 0.01 m, projection inside the picture grown by 15 %). A Gaussian that no camera
// sees gets the largest f.
//   in   params [groups][planes][16], cameras [n_cameras]
//   mid  pieces [LAYOUT_LOSS_PIECES]: largest z of a piece
//   out  filter [groups][16], m
// Reference: mip_ref_filter.
#define MIP_SIGMA 0.4472135954999579f // sqrt(0.2)

inline V mip_nearest(__global const float *g, __global const struct layout_mip_camera *cameras,
                     uint n)
{
    V x = LD(g, LAYOUT_PLANE_MEAN), y = LD(g, LAYOUT_PLANE_MEAN + 1),
      z = LD(g, LAYOUT_PLANE_MEAN + 2), nearest = (V)(INFINITY);
    for (uint i = 0; i < n; i++) {
        __global const struct layout_mip_camera *c = cameras + i;
        V cz = c->rot[6] * x + (c->rot[7] * y + (c->rot[8] * z + c->trans[2]));
        V cx = c->rot[0] * x + (c->rot[1] * y + (c->rot[2] * z + c->trans[0]));
        V cy = c->rot[3] * x + (c->rot[4] * y + (c->rot[5] * z + c->trans[1]));
        V u = cx * c->fx + c->cx * cz, v = cy * c->fy + c->cy * cz; // times z
        VI in = (cz > LAYOUT_MIP_NEAR_M) & (u >= -LAYOUT_MIP_GROW * c->width * cz) &
                (u <= (1.0f + LAYOUT_MIP_GROW) * c->width * cz) &
                (v >= -LAYOUT_MIP_GROW * c->height * cz) &
                (v <= (1.0f + LAYOUT_MIP_GROW) * c->height * cz);
        nearest = (in & (cz < nearest)) ? cz : nearest;
    }
    return nearest;
}

__kernel void mip_depth(__global const float *params, uint n, uint planes, uint groups,
                        __global const struct layout_mip_camera *cameras, uint n_cameras,
                        __global float *filter, __global float *pieces)
{
    uint item = (uint)get_global_id(0);
    if (item >= LAYOUT_LOSS_PIECES)
        return;
    uint from = PIECE_FROM(item, LAYOUT_LOSS_PIECES, groups),
         to = PIECE_FROM(item + 1, LAYOUT_LOSS_PIECES, groups);
    V largest = (V)(0.0f);
    for (uint group = from; group < to; group++)
        LANES_EACH(lane)
        {
            V z = mip_nearest(params + group_at(group, planes) + lane, cameras, n_cameras);
            VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
            largest = (real & (z < INFINITY) & (z > largest)) ? z : largest;
            ST(filter + group_at(group, 1) + lane, 0, z);
        }
    pieces[item] = lanes_max(largest);
}

__kernel void mip_fill(uint groups, float per_m, __global const float *pieces,
                       __global float *filter)
{
    uint item = (uint)get_global_id(0);
    if (item >= LAYOUT_LOSS_PIECES)
        return;
    uint from = PIECE_FROM(item, LAYOUT_LOSS_PIECES, groups),
         to = PIECE_FROM(item + 1, LAYOUT_LOSS_PIECES, groups);
    float largest = 0.0f;
    for (uint i = 0; i < LAYOUT_LOSS_PIECES; i++)
        largest = fmax(largest, pieces[i]);
    for (uint group = from; group < to; group++)
        LANES_EACH(lane)
        {
            V z = LD(filter + group_at(group, 1) + lane, 0);
            z = z < INFINITY ? z : (V)(largest);
            ST(filter + group_at(group, 1) + lane, 0, MIP_SIGMA * per_m * z);
        }
}

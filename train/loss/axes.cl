// Sigmas of a group of Gaussians (VW 1: of one Gaussian), and the part of the ground on which it
// lies: what the kernels behind it share (train/loss/scale_loss.cl, train/loss/flat_loss.cl).
#define RATIO_EPS 1e-8f
#define AXES_AHEAD 8
#define LIMITED 1 // enum ground_part
#define FLAT 2

struct ground { // grid of parts, uchar [ny][nx]; nx 0: there is none
    float corner_x, corner_y, per_m;
    uint nx, ny;
    __global const uchar *parts;
};

struct axes { // sigmas, and the ratio of the largest to the middle one
    V s[3], largest, middle, least, ratio;
};

#if VW == 16
// Which group of params that is. Groups lie further apart than the hardware looks ahead.
inline uint axes_group(__global const float *params, uint group, uint groups, uint planes,
                       __global const uint *list, uint listed)
{
    uint next = min(group + AXES_AHEAD, groups - 1), ahead = listed ? list[next] : next;
    for (uint k = 0; k < LAYOUT_PLANES_SCALE; k++)
        PREFETCH(params + group_at(ahead, planes) + (LAYOUT_PLANE_SCALE + k) * LAYOUT_LANES);
    return listed ? list[group] : group;
}
#endif

inline void axes_load(__global const float *g, struct axes *a)
{
    for (uint k = 0; k < 3; k++)
        a->s[k] = exp(LD(g, LAYOUT_PLANE_SCALE + k));
    V ab = MIN_(a->s[0], a->s[1]), top = MAX_(a->s[0], a->s[1]), below = MIN_(top, a->s[2]);
    a->largest = MAX_(top, a->s[2]);
    a->middle = MAX_(ab, below);
    a->least = MIN_(ab, a->s[2]);
    a->ratio = a->largest / (a->middle + RATIO_EPS);
}

// A fresh buffer gets the value, another one is added to.
INLINE void axes_store(__global float *out, uint plane, V h, uint fresh)
{
    ST(out, plane, fresh ? h : LD(out, plane) + h);
}

#define GROUND_ARGS                                                                                \
    float corner_x, float corner_y, float per_m, uint nx, uint ny, __global const uchar *parts
#define GROUND                                                                                     \
    {                                                                                              \
        corner_x, corner_y, per_m, nx, ny, parts                                                   \
    }

/* Rays into a procedural city: distance, class and brightness at every pixel of a camera.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_TRUTH_RAYS_H
#define LAB_TRUTH_RAYS_H

#include "lab/truth/map_views.h"
#include "scene/synth/synth.h"

struct truth_city { /* free with truth_city_close */
    struct synth_config cfg;
    struct synth_city city;
    struct arena arena;
    struct map_move to_scene, from_scene; /* between the city's ENU and the scene's */
    double gsd_m, flight_m;               /* of photographs that look straight down */
};
/* Opens a city that `citysplat synth` made in this folder, in relation to the scene. Errors of
 * truth_config and map_views_move; ERR_MEM. */
enum err_code truth_city_open(const char *folder, const struct scene *s, struct truth_city *out,
                              struct err *e) ERR_USE;
void truth_city_close(struct truth_city *c);

struct truth_pixel {
    float t_m;    /* along the unit ray from the camera's plane or centre; 0: sky */
    float enu[3]; /* place of the hit, in the city's ENU */
    float bright; /* sRGB luma, 0 to 1 */
    uint8_t kind; /* enum surface_class */
    bool inside;  /* in the built-up square */
};
struct truth_view { /* rays of a camera in the city's ENU */
    struct camera cam;
    bool orthographic;
    bool shaded;   /* brightness is needed */
    uint32_t step; /* every step-th pixel of every step-th row, from 0 */
};
/* Computes the ray through a place of the picture; dir has length 1. Returns the length of the ray
 * for a metre of depth. */
double truth_ray(const struct truth_view *v, double x_px, double y_px, double from[3],
                 double dir[3]);
bool truth_inside(const struct truth_city *c, const double enu_m[3]);
/* Computes all rays, row by row, on all cores. ERR_CANCEL. */
enum err_code truth_rays(const struct truth_city *c, const struct truth_view *v,
                         struct truth_pixel *out, struct err *e) ERR_USE;

#endif

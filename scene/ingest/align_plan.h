/* Describes a folder of photographs before poses are computed: which cameras took them, which of
 * them may see the same ground, and which are broken, blurred or copies.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_ALIGN_PLAN_H
#define SCENE_INGEST_ALIGN_PLAN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"

struct align_photo {
    const char *name; /* below the folder */
    char link[32];    /* the name that COLMAP gets, without blanks: "000017.jpg" */
    uint32_t width_px, height_px;
    char camera[96]; /* by EXIF; "" = not given */
    double focal_mm; /* 0 = not given */
    double focal_px; /* by the focal length on 35 mm film; 0 = not known */
    double time_s;   /* NAN = not given */
    bool has_gps;
    double at_m[2];      /* east and north by GPS, about the first photograph that has it */
    double height_m;     /* above take-off; NAN = not known */
    double sharp;        /* fine detail divided by contrast, in the picture shrunk to 800 px */
    struct hash128 hash; /* of the file */
    size_t group;        /* camera, lens and focal length */
    size_t cluster;      /* photographs that lie together by GPS */
    size_t copy_of;      /* an earlier one with the same bytes; SIZE_MAX: none */
    bool blurred;        /* much less sharp than the others */
    char *fault;         /* why the photograph cannot be read; NULL: it can */
};
struct align_pair {
    uint32_t a, b; /* a < b */
};
struct align_plan {             /* {0} is empty; align_plan_free */
    struct align_photo *photos; /* [n] by folder, time and name */
    size_t n, n_usable, n_gps;  /* usable: neither broken nor a copy */
    size_t n_groups, n_clusters, n_copies, n_blurred, n_broken;
    double apart_m; /* distance of the two largest clusters; 0: there is one */
    /* overlap of neighbours, by GPS, height and focal length; NAN: not known */
    double overlap;
    double megapixels;        /* mean of usable photographs */
    struct align_pair *pairs; /* [n_pairs] */
    size_t n_pairs;
    struct arena arena;
};
/* Reads EXIF and pixels of all photographs below a folder. ERR_NOENT, ERR_DATA (fewer than three
 * can be used), ERR_IO, ERR_LIMIT, ERR_CANCEL, ERR_MEM. */
enum err_code align_plan_read(const char *dir, struct align_plan *out, struct err *e) ERR_USE;
/* Chooses the pairs to compare: each photograph with the nearest ones by GPS and with the next ones
 * in order. Without GPS it takes more of the next ones, or all pairs if there are few photographs.
 * ERR_MEM. */
enum err_code align_plan_pairs(struct align_plan *p, size_t neighbours, size_t next,
                               struct err *e) ERR_USE;
bool align_plan_usable(const struct align_photo *p);
/* Index of a link; SIZE_MAX: none. */
size_t align_plan_find(const struct align_plan *p, const char *link);
void align_plan_free(struct align_plan *p);

/* ---- a forecast ---- */

struct align_forecast {
    uint32_t edge_px;                      /* longest edge of pictures for features */
    uint32_t features;                     /* most features of a photograph */
    double features_s, matches_s, model_s; /* processor seconds */
};
/* How fast a machine is. */
struct align_pace {
    size_t cores;
    double slow; /* processor seconds of a piece of work, relative to the usual machine */
    double load; /* seconds by the clock, relative to those without other programs; at least 1 */
};
/* The pace by which sizes are chosen, so that other programs do not change them: no load, and the
 * usual machine unless this one is four times slower or faster. */
struct align_pace align_plan_pace(const struct align_pace *measured);
/* Forecasts the processor seconds of the stages. They hardly depend on other programs. */
struct align_forecast align_plan_forecast(const struct align_plan *p, uint32_t edge_px,
                                          uint32_t features, double slow);
/* Processor seconds of the look: a quick first comparison in small pictures. The plan's pairs are
 * those of the whole work, of which the look compares a part. */
double align_plan_look_s(const struct align_plan *p, double slow);
/* Sum of the stages. */
double align_plan_cpu_s(const struct align_forecast *f);
/* Seconds by the clock. Features and pairs use all cores, the model about one and a half. */
double align_plan_clock_s(const struct align_forecast *f, const struct align_pace *pace);
enum { ALIGN_PLAN_FEATURES_MOST = 8192 };
/* Chooses the finest of the usual values of edge_px and features that takes at most so many seconds
 * by the clock at align_plan_pace, or else the coarsest. An argument edge_px or features that is
 * not 0 is kept. The forecast is for the actual pace. */
struct align_forecast align_plan_afford(const struct align_plan *p, uint32_t edge_px,
                                        uint32_t features, const struct align_pace *pace,
                                        double seconds);

#endif

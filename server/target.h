/* A request target (RFC 9112, section 3.2) as integers and enums: what router.c reads from it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TARGET_H
#define SERVER_TARGET_H

#include "core/base.h"
#include "lod/key.h"
#include "server/format.h"

struct route;

enum { TARGET_KEPT_MAX = 64 };   /* a name that an appearance is kept under, with its NUL */
enum { TARGET_STREAM_MIN = 16 }; /* a name cannot be guessed: whoever knows it steers */
enum { TARGET_CLIP_CORNERS = 40, TARGET_CLIP_TEXT = TARGET_CLIP_CORNERS * 26 };
enum {
    TARGET_APPEARANCE_MAX = 512,
    TARGET_QUERY_MAX = 3 * TARGET_APPEARANCE_MAX + TARGET_CLIP_TEXT + 96
};
enum { TARGET_SIDE_MAX = 1 << 20 }; /* pixels of a side: far beyond what is drawn */

struct target_pose {              /* fixed point, so that equal views are equal keys */
    int32_t lon_e7, lat_e7;       /* 1e-7 degrees */
    int32_t h_mm;                 /* ellipsoidal, mm */
    int32_t heading_e3, pitch_e3; /* 1e-3 degrees; heading 0..359999 */
    int32_t fov_e3;               /* vertical */
    int32_t roll_e3;              /* clockwise, 0..359999 */
};
/* What is behind the Gaussians of a picture, or in place of their colours; how fine it is drawn. */
enum background { BACKGROUND_COLOUR, BACKGROUND_SKY, BACKGROUND_TRANSPARENT };
enum depth { DEPTH_NONE, DEPTH_MM, DEPTH_CM, DEPTH_DM, DEPTH_M }; /* unit of a picture of depth */
struct paint {                                                    /* {0}: on black */
    enum background background;
    uint32_t rgb; /* of BACKGROUND_COLOUR: 0xRRGGBB */
    enum depth depth;
    bool said_background;
    uint32_t supersample; /* pixels drawn for one on each axis; 0: as the server finds best */
};
/* A tile's bytes are those of a format, and of the quantised ones (.glb .spz .drc) in a preset and
 * a degree of harmonics. */
enum { FORM_UNSAID = 255 };
struct form {
    enum format format;
    uint8_t preset;    /* enum quant_preset; QUANT_PRESETS: not said */
    uint8_t sh_degree; /* highest band; FORM_UNSAID */
    bool trained;      /* colours as they were trained, no appearance applied; never said here */
};
/* How a picture holds heights: what each of its colours is worth. */
enum encoding {
    ENCODING_UNSAID,
    ENCODING_MAPBOX,   /* -10000 + 0.1 (65536 R + 256 G + B) metres */
    ENCODING_TERRARIUM /* -32768 + 256 R + G + B / 256 metres */
};
/* Where a camera goes (course.h), in thousandths but for pixels; 0: not said. */
struct target_course {
    const char *path; /* [n_path], borrowed from the target's text; NULL: no camera is named */
    size_t n_path;
    uint32_t width_px, height_px, fov_e3, error_e3, speed_e3, horizon_e3;
};
/* A polygon that does not cross itself; in one spelling, so that equal ones are equal bytes. */
struct target_clip {
    uint32_t n; /* corners, 0: none was said */
    int32_t corner_e7[TARGET_CLIP_CORNERS][2];
};
enum search_sort { SEARCH_BY_NUMBER, SEARCH_BY_DISTANCE, SEARCH_BY_TIME, SEARCH_BY_COLOUR };
struct target_search { /* of appearances; the target has bbox and page */
    bool asked, has_near, has_time, has_hours, has_colour, kept; /* kept: named ones alone */
    int32_t near_e7[2];
    uint32_t radius_e3; /* m; 0: any */
    int64_t time_s[2];  /* since 1970 by the cameras' clocks, both included */
    uint8_t hours[2];   /* from, and to without it; over midnight where from is the later */
    uint32_t rgb;
    enum search_sort sort;
};
struct target {
    const struct route *route;        /* NULL: none */
    char ds[64], rev[13], edition[9]; /* edition: "": not said */
    struct key key;
    struct form form;                       /* of views only the format counts */
    char appearance[TARGET_APPEARANCE_MAX]; /* "": not said */
    char kept[TARGET_KEPT_MAX];             /* of KEPT; elsewhere the name that appearance was,
                                             * before it became what it stands for; "": none */
    struct target_clip clip;                /* of tiles and what lists them */
    struct target_pose pose; /* of height: longitude and latitude alone, if has_place */
    bool has_place;
    uint32_t width_px, height_px; /* of the picture, @2x and so on counted */
    struct paint paint;
    uint8_t scale;          /* of map and terrain tiles: 1, or 2 for twice the pixels */
    enum encoding encoding; /* of terrain */
    uint32_t row;           /* of a thumbnail */
    char stream[64];        /* of motion */
    struct target_search search;
    /* seed, collections and search: */
    bool has_bbox;
    int32_t bbox_e7[4]; /* west south east north */
    bool has_heights;   /* these of collections */
    int64_t heights_mm[2];
    /* seed, and search: */
    uint8_t z_min, z_max;
    uint32_t after, limit; /* lines that are left out before, and at most */
    struct target_course course;
    size_t path_size; /* bytes of the path, before '?' */
};

#endif

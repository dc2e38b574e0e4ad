/* A request target (RFC 9112, section 3.2) as integers and enums, as router.c parses it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TARGET_H
#define SERVER_TARGET_H

#include "core/base.h"
#include "lod/key.h"
#include "server/format.h"
#include "server/text.h"

struct route;

enum { TARGET_KEPT_MAX = 64 }; /* name of an appearance, with its NUL */
/* a name must be hard to guess, because it gives the right to steer */
enum { TARGET_STREAM_MIN = 16 };
enum { TARGET_CLIP_CORNERS = 40, TARGET_CLIP_TEXT = TARGET_CLIP_CORNERS * 26 };
enum {
    TARGET_APPEARANCE_MAX = 512,
    TARGET_QUERY_MAX = 3 * TARGET_APPEARANCE_MAX + TARGET_CLIP_TEXT + 96
};
enum { TARGET_SIDE_MAX = 1 << 20 }; /* pixels of an edge, far more than in any picture */

struct target_pose {              /* fixed point, so that equal views have equal keys */
    int32_t lon_e7, lat_e7;       /* 1e-7 degrees */
    int32_t h_mm;                 /* ellipsoidal, mm */
    int32_t heading_e3, pitch_e3; /* 1e-3 degrees; heading 0..359999 */
    int32_t fov_e3;               /* vertical, 1e-3 degrees */
    int32_t roll_e3;              /* clockwise, 1e-3 degrees, 0..359999 */
};
/* The background of a picture, or depth instead of its colours, and its supersampling. */
enum background { BACKGROUND_COLOUR, BACKGROUND_SKY, BACKGROUND_TRANSPARENT };
enum depth { DEPTH_NONE, DEPTH_MM, DEPTH_CM, DEPTH_DM, DEPTH_M }; /* unit of a depth picture */
struct paint {                                                    /* {0}: black background */
    enum background background;
    uint32_t rgb; /* for BACKGROUND_COLOUR: 0xRRGGBB */
    enum depth depth;
    bool said_background;
    uint32_t supersample; /* pixels drawn for one on each axis; 0: the server chooses */
};
/* The form of a tile: its format, for quantised formats (.glb .spz .drc) a preset and a degree of
 * harmonics, and for .drc a part. */
enum { FORM_UNSAID = 255 };
struct form {
    enum format format;
    uint8_t preset;    /* enum quant_preset; QUANT_PRESETS: not given */
    uint8_t sh_degree; /* highest band; FORM_UNSAID: not given */
    uint8_t part;      /* of .drc: 1 or 2 (codec/part.h); 0: all of it */
    bool trained;      /* trained colours without an appearance; never set by the parser */
};
/* How a picture codes heights in its colours. */
enum encoding {
    ENCODING_UNSAID,
    ENCODING_MAPBOX,   /* -10000 + 0.1 (65536 R + 256 G + B) metres */
    ENCODING_TERRARIUM /* -32768 + 256 R + G + B / 256 metres */
};
/* A polygon that does not cross itself, in its only spelling, so that equal polygons are equal
 * bytes. */
struct target_clip {
    uint32_t n; /* number of corners; 0: not given */
    int32_t corner_e7[TARGET_CLIP_CORNERS][2];
};
enum search_sort { SEARCH_BY_NUMBER, SEARCH_BY_DISTANCE, SEARCH_BY_TIME, SEARCH_BY_COLOUR };
struct target_search { /* search for appearances; the target has bbox and page */
    bool asked, has_near, has_time, has_hours, has_colour, kept; /* kept: only named ones */
    int32_t near_e7[2];
    uint32_t radius_e3; /* m; 0: any */
    int64_t time_s[2];  /* since 1970, by the cameras' clocks; both ends included */
    uint8_t hours[2];   /* from, and to (excluded); over midnight if from is later */
    uint32_t rgb;
    enum search_sort sort;
};
struct target {
    const struct route *route;        /* NULL: none */
    char ds[64], rev[13], edition[9]; /* edition "": not given */
    struct key key;
    struct form form;                       /* for views only the format is used */
    char appearance[TARGET_APPEARANCE_MAX]; /* "": not given */
    /* for KEPT; elsewhere the name that `appearance` held before its meaning replaced it; "": none
     */
    char kept[TARGET_KEPT_MAX];
    struct target_clip clip; /* for tiles and documents that list them */
    struct target_pose pose; /* for height only longitude and latitude, if has_place */
    bool has_place;
    uint32_t width_px, height_px; /* of the picture, with the factor of @2x and so on */
    struct paint paint;
    uint8_t scale;          /* for map and terrain tiles: 1, or 2 for twice the pixels */
    enum encoding encoding; /* for terrain */
    uint32_t row;           /* for a thumbnail */
    struct target_part {
        uint32_t column, line;
    } part;           /* of a photograph */
    char stream[64];  /* for motion */
    uint8_t video;    /* for motion: 1: VP9; 0: separate pictures */
    struct text seal; /* borrowed from the target's text; for a signed address */
    struct target_search search;
    /* for seed, collections and search: */
    bool has_bbox;
    int32_t bbox_e7[4]; /* west south east north */
    bool has_heights;   /* these for collections */
    int64_t heights_mm[2];
    /* for seed and search: */
    uint8_t z_min, z_max;
    uint32_t after, limit; /* number of lines to skip, and largest number of lines */
    size_t path_size;      /* bytes of the path, without the query */
};

#endif

/* A request target (RFC 9112, section 3.2) as integers and enums, as router.c parses it.
 *
 * Parameters that belong together are a group. A row of routes.def says which groups its route
 * takes. The target of route NAME is a struct NAME_target. It has the members that all targets
 * have, then these groups and no others, so an answer sees only the parameters of its own route.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TARGET_H
#define SERVER_TARGET_H

#include <assert.h>
#include <string.h>

#include "core/base.h"
#include "lod/store/key.h"
#include "server/base/format.h"
#include "server/base/text.h"
#include "server/route/route.h"

enum { TARGET_KEPT_MAX = 64 }; /* name of an appearance, with its NUL */
/* a name must be hard to guess, because it gives the right to steer */
enum { TARGET_STREAM_MIN = 16 };
enum { TARGET_CLIP_CORNERS = 40, TARGET_CLIP_TEXT = TARGET_CLIP_CORNERS * 26 };
enum {
    TARGET_APPEARANCE_MAX = 512,
    TARGET_QUERY_MAX = 3 * TARGET_APPEARANCE_MAX + TARGET_CLIP_TEXT + 96
};
enum { TARGET_SIDE_MAX = 1 << 20 }; /* pixels of an edge, far more than in any picture */

/* ---- what all have ---- */

struct target_names {
    char ds[64], rev[13], edition[9]; /* edition "": not given */
    /* name of an appearance: of the path, or that `appearance` held before its meaning replaced it;
     * "": none */
    char kept[TARGET_KEPT_MAX];
};
struct target {
    struct target_names names;
    const struct route *route; /* NULL: none */
    size_t path_size;          /* bytes of the path, without the query */
};

/* ---- groups ---- */

/* cell: a tile of Web Mercator. */
struct target_cell {
    struct key key;
    uint8_t scale; /* of map and terrain tiles: 1, or 2 for twice the pixels */
};
/* tiles: how tiles of Gaussians are asked for; also by documents that list them. */
enum { FORM_UNSAID = 255 };
struct form { /* of a tile; for quantised formats (.glb .spz .drc) preset and degree of harmonics */
    enum format format;
    uint8_t preset;    /* enum quant_preset; QUANT_PRESETS: not given */
    uint8_t sh_degree; /* highest band; FORM_UNSAID: not given */
    uint8_t part;      /* of .drc: 1 or 2 (codec/splat/part.h); 0: all of it */
    bool trained;      /* trained colours without an appearance; never set by the parser */
};
/* A polygon that does not cross itself, in canonical form: equal polygons are equal bytes. */
struct target_clip {
    uint32_t n; /* number of corners; 0: not given */
    int32_t corner_e7[TARGET_CLIP_CORNERS][2];
};
struct target_tiles {
    struct form form; /* its part with MAY(part) alone */
    struct target_clip clip;
    char appearance[TARGET_APPEARANCE_MAX]; /* "": not given */
};
/* appearance: of pictures, maps and documents. */
struct target_appearance {
    char appearance[TARGET_APPEARANCE_MAX]; /* "": not given */
};
/* page: of a list. */
struct target_page {
    bool has_bbox;
    int32_t bbox_e7[4];    /* west south east north */
    uint32_t after, limit; /* number of lines to skip, and largest number of lines */
};
/* zooms: of a prefetch list, and whose requests it is to hold. */
enum client { CLIENT_NONE, CLIENT_CESIUM, CLIENT_THREE, CLIENT_VIEWER, CLIENT_ALL };
struct target_zooms {
    uint8_t z_min, z_max;
    uint8_t client; /* enum client; CLIENT_NONE: tiles in one form, that of `tiles` */
};
/* box: of collections. */
struct target_box {
    bool has_bbox, has_heights;
    int32_t bbox_e7[4]; /* west south east north */
    int64_t heights_mm[2];
};
/* view: a rendered view. */
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
struct composite {                                                /* {0}: black background */
    enum background background;
    uint32_t rgb; /* for BACKGROUND_COLOUR: 0xRRGGBB */
    enum depth depth;
    bool said_background;
    uint32_t supersample; /* pixels drawn for one on each axis; 0: the server chooses */
};
struct target_view {
    struct target_pose pose;
    uint32_t width_px, height_px; /* with the factor of @2x and so on */
    uint8_t scale;
    enum format format;
    struct composite composite;
};
/* map: a map tile. */
struct target_map {
    enum format format;
};
/* terrain: heights as colours. */
enum encoding {
    ENCODING_UNSAID,
    ENCODING_MAPBOX,   /* -10000 + 0.1 (65536 R + 256 G + B) metres */
    ENCODING_TERRARIUM /* -32768 + 256 R + G + B / 256 metres */
};
struct target_terrain {
    enum encoding encoding;
    bool ground; /* bare ground, not the surface */
};
/* place: of a question. */
struct target_place {
    bool given;
    int32_t lon_e7, lat_e7;
    int32_t gsd_mm; /* edge of a pixel; 0: the usual one */
};
/* stream: pictures that follow a camera. */
struct target_stream {
    char name[64];
    uint8_t video; /* 1: VP9; 0: separate pictures */
};
/* row: number of a photograph; column and row of a part of it. */
struct target_row {
    uint32_t row, column, line;
};
/* seal: of a signed address; borrowed from the target's text. */
struct target_seal {
    struct text text;
};

/* A group's name is its struct's, its enumerator's and that of the member of a route's target. */
enum target_group {
    TARGET_names, /* of every route */
    TARGET_cell,
    TARGET_tiles,
    TARGET_part, /* no struct: `tiles` with ?part= */
    TARGET_appearance,
    TARGET_page,
    TARGET_zooms,
    TARGET_box,
    TARGET_view,
    TARGET_map,
    TARGET_terrain,
    TARGET_place,
    TARGET_stream,
    TARGET_row,
    TARGET_seal,
    TARGET_GROUPS
};
static_assert((int)TARGET_GROUPS == (int)ROUTE_GROUPS, "a route says where each group is");

/* ---- the target of each route ---- */

#define TAKES(route, group) struct target_##group group;
#define MAY(group)
#define ROUTE(name, path, scope, cache, rate, takes, on)                                           \
    struct name##_target {                                                                         \
        struct target all;                                                                         \
        takes                                                                                      \
    };
#include "server/route/routes.def"
#undef ROUTE
#undef TAKES
#undef MAY

/* Room for any of them. */
union target_any {
    struct target all;
#define ROUTE(name, path, scope, cache, rate, takes, on) struct name##_target of_##name;
#include "server/route/routes.def"
#undef ROUTE
};

static inline bool target_is(const struct target *t, const char *row)
{
    return !strcmp(t->route->name, row);
}

/* target_of_tile(t) and so on: what a row's answer got, which is the target of that row. */
#define ROUTE(name, path, scope, cache, rate, takes, on)                                           \
    static inline const struct name##_target *target_of_##name(const struct target *t)             \
    {                                                                                              \
        assert(target_is(t, #name));                                                               \
        return (const struct name##_target *)t;                                                    \
    }
#include "server/route/routes.def"
#undef ROUTE

/* A group of a target of any route. NULL: its route does not take it. */
static inline void *target_group(struct target *t, enum target_group group)
{
    return t->route->at[group] ? (char *)t + t->route->at[group] : NULL;
}

#endif

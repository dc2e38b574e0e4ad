/* Bytes <-> structs: images and EXIF, COLMAP models, scenes, checkpoints, and every file of
 * Gaussians.
 *
 * Decoders are safe on any bytes: they check counts against the bytes at hand before they allocate,
 * keep to codec_limits, and on error leave their output empty. Writers of files go through core's
 * file_begin.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_CODEC_H
#define CODEC_CODEC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/camera.h"
#include "core/gauss.h"
#include "core/geo.h"

#ifdef __cplusplus
extern "C" {
#endif

#define CODEC_MAX_GAUSSIANS ((size_t)64 << 20)
#define CODEC_MAX_BYTES ((size_t)16 << 30)
#define CODEC_MAX_PIXELS ((size_t)512 << 20)

struct codec_limits {     /* {0} = the defaults in brackets */
    size_t max_gaussians; /* [64 Mi] */
    size_t max_bytes;     /* decompressed bytes of one file [16 GiB] */
    size_t max_pixels;    /* of one image [512 Mi] */
};

/* ---- image_shim.cc (OpenImageIO) ---- */

struct image {                              /* {0} is empty */
    uint32_t width_px, height_px, channels; /* 1 or 3 */
    uint8_t *px;                            /* [h][w][channels], sRGB values as stored */
};
struct image_gps {
    bool has_position, has_altitude;
    double lat_deg, lon_deg, alt_m;   /* alt_m as the file says it: usually above sea level */
    char time[32];                    /* EXIF DateTimeOriginal or "" */
    double exposure_s, iso, focal_mm; /* 0 = not given */
};
/* Read as 8-bit RGB (grey is expanded, alpha dropped), EXIF orientation ignored as COLMAP does.
 * ERR_NOENT, ERR_FORMAT (not an image; says which file), ERR_LIMIT. image_free it. */
enum err_code image_read(const char *path, const struct codec_limits *lim, struct image *out,
                         struct err *e) ERR_USE;
/* Size and EXIF only, without decoding pixels. Either output may be NULL. */
enum err_code image_read_info(const char *path, uint32_t *width_px, uint32_t *height_px,
                              struct image_gps *gps, struct err *e) ERR_USE;
/* First channel as floats, [h][w]: 8- and 16-bit files as 0..1, float files (.pfm .tif .exr) as
 * they are. For maps, not photographs. *data is allocated; mem_free it. Errors as image_read. */
enum err_code image_read_map(const char *path, const struct codec_limits *lim, uint32_t *width_px,
                             uint32_t *height_px, float **data, struct err *e) ERR_USE;
/* By extension: .jpg .png .webp .tif. quality 1..100 for jpg and webp (0 = 95; jpg >= 95 writes
 * 4:4:4). gps (may be NULL) goes into EXIF. */
enum err_code image_write(const char *path, const struct image *img, int quality,
                          const struct image_gps *gps, struct err *e) ERR_USE;
/* The same into memory; format is "jpg", "png" or "webp". */
enum err_code image_encode(const struct image *img, const char *format, int quality,
                           struct buf *out, struct err *e) ERR_USE;
/* image_resize.c: Lanczos3. out is allocated; image_free it. */
enum err_code image_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                           struct image *out, struct err *e) ERR_USE;
enum err_code image_alloc(uint32_t width_px, uint32_t height_px, uint32_t channels,
                          struct image *out, struct err *e) ERR_USE;
void image_free(struct image *img);

/* ---- exif.c: the few EXIF fields we need, in JPEG, PNG, WebP and TIFF files ---- */

/* Missing, unknown or damaged fields are simply not there (has_position false, 0, ""): photographs
 * with strange EXIF are still photographs. ERR_NOENT, ERR_IO. */
enum err_code exif_read(const char *path, struct image_gps *out, struct err *e) ERR_USE;
/* The same from a whole file in memory. */
void exif_parse(const void *bytes, size_t n, struct image_gps *out);
/* Put an EXIF block into an encoded picture. Angles are stored to 1e-7 arc seconds, heights to 0.1
 * mm. */
enum err_code exif_insert(struct buf *file, const struct image_gps *gps, struct err *e) ERR_USE;

/* ---- npy.c ---- */

/* float32 .npy, C order. shape has ndim entries. npy_read allocates (mem_free). */
enum err_code npy_write(const char *path, const float *data, size_t ndim, const size_t *shape,
                        struct err *e) ERR_USE;
enum err_code npy_read(const char *path, size_t ndim, size_t *shape, float **data,
                       struct err *e) ERR_USE;
enum err_code npy_decode(const void *bytes, size_t n, size_t ndim, size_t *shape, float **data,
                         struct err *e) ERR_USE;

/* ---- colmap.c ---- */

struct colmap_camera {
    uint32_t id;
    struct lens lens;
};
struct colmap_observation {
    double x_px, y_px;
    int64_t point; /* index into colmap_model.points, -1 = none */
};
struct colmap_image {
    uint32_t id;
    double quat_wxyz[4], trans[3]; /* world -> camera */
    size_t camera;                 /* index into cameras */
    char *name;
    struct colmap_observation *obs;
    size_t n_obs;
};
struct colmap_track_element {
    uint32_t image; /* index into images */
    uint32_t obs;   /* index into that image's obs */
};
struct colmap_point {
    uint64_t id;
    double xyz[3];
    uint8_t rgb[3];
    double error_px;
    size_t track, n_track; /* slice of colmap_model.tracks */
};
struct colmap_model { /* {0} is empty; sorted by id; ids are resolved to indices and checked */
    struct colmap_camera *cameras;
    size_t n_cameras;
    struct colmap_image *images;
    size_t n_images;
    struct colmap_point *points;
    size_t n_points;
    struct colmap_track_element *tracks;
    size_t n_tracks;
    struct arena arena; /* owns everything above */
};
/* From a folder that holds cameras/images/points3D as .bin (preferred) or .txt, or its sparse/ or
 * sparse/0/. ERR_NOENT names what was looked for; ERR_FORMAT names file and record ("images.bin:
 * image 17 of 75: truncated"). colmap_free it. */
enum err_code colmap_read(const char *dir, struct colmap_model *out, struct err *e) ERR_USE;
enum err_code colmap_write_bin(const char *dir, const struct colmap_model *m,
                               struct err *e) ERR_USE;
void colmap_free(struct colmap_model *m);

/* ---- scene.c: what ingest makes and train reads ---- */

enum scene_split { SCENE_TRAIN, SCENE_TEST };
struct scene_image {
    char *name;        /* file in images/, borrowed from the scene's arena */
    struct camera cam; /* undistorted pinhole, world = ENU metres */
    enum scene_split split;
    uint32_t group;      /* appearance group; one per photograph by default */
    double gps_enu_m[3]; /* NaN when there is none */
    double residual_m;   /* after registration; NaN when there is no GPS */
};
struct scene_point {
    double enu_m[3];
    uint8_t rgb[3];
    float error_px;
    uint32_t track_length;
};
struct scene { /* {0} is empty */
    struct geo_origin origin;
    double scale, rot[9], trans[3]; /* COLMAP -> ENU: y = scale * rot * x + trans */
    double vertical_offset_m; /* fitted GPS altitude offset kept apart, see docs/conventions.md */
    struct scene_image *images;
    size_t n_images;
    struct scene_point *points;
    size_t n_points;
    struct scene_track {
        uint32_t point, image;
        float x_px, y_px;
    } * tracks; /* sorted by image; image pixels after undistortion and resize */
    size_t n_tracks;
    char *attribution; /* may be NULL */
    char dir[FILE_PATH_MAX];
    struct arena arena;
};
/* scene.json + points.bin of a scene folder. scene_free it. */
enum err_code scene_read(const char *dir, struct scene *out, struct err *e) ERR_USE;
enum err_code scene_write(const char *dir, const struct scene *s, struct err *e) ERR_USE;
void scene_free(struct scene *s);

/* ---- ckpt.c: one file, a JSON head and named blobs, hashed ---- */

struct ckpt_blob {
    char name[32];
    const void *data; /* write: borrowed; read: points into the ckpt's buffer, 64-byte aligned */
    size_t size_bytes;
};
struct ckpt {            /* {0} is empty */
    struct json_t *meta; /* level, step, seed, config, metrics ... */
    struct gauss g;
    struct ckpt_blob *blobs;
    size_t n_blobs;
    struct buf file;
};
/* meta must be an object; g may be empty. Written beside and renamed. */
enum err_code ckpt_write(const char *path, const struct json_t *meta, const struct gauss *g,
                         const struct ckpt_blob *blobs, size_t n_blobs, struct err *e) ERR_USE;
/* The same of Gaussians that are not there as a container: each array is asked for in slices, from
 * front to back. */
enum ckpt_field { CKPT_MEAN, CKPT_SCALE, CKPT_QUAT, CKPT_OPACITY, CKPT_SH, CKPT_EMBED };
struct ckpt_source {
    const struct gauss *like; /* counts, kind and origin; its arrays are not looked at */
    enum err_code (*rows)(void *user, enum ckpt_field field, size_t first, size_t n, float *out,
                          struct err *e); /* out: as in struct gauss, row `first` in front */
    void *user;
};
enum err_code ckpt_write_from(const char *path, const struct json_t *meta,
                              const struct ckpt_source *from, const struct ckpt_blob *blobs,
                              size_t n_blobs, struct err *e) ERR_USE;
/* ERR_FORMAT when truncated or when a hash differs. ckpt_free it. */
enum err_code ckpt_read(const char *path, struct ckpt *out, struct err *e) ERR_USE;
const struct ckpt_blob *ckpt_find(const struct ckpt *c, const char *name); /* NULL when absent */
void ckpt_free(struct ckpt *c);
/* The Gaussians of a checkpoint by the slice, for those larger than memory. Opening reads it once
 * against its hashes; rows may be read from several threads. */
struct ckpt_rows;
enum err_code ckpt_rows_open(const char *path, struct ckpt_rows **out, struct err *e) ERR_USE;
size_t ckpt_rows_count(const struct ckpt_rows *r);
const struct gauss *ckpt_rows_like(const struct ckpt_rows *r); /* without arrays */
enum err_code ckpt_rows_meta(const struct ckpt_rows *r, struct json_t **out,
                             struct err *e) ERR_USE; /* json_decref it */
enum err_code ckpt_rows_read(const struct ckpt_rows *r, size_t from, size_t n, struct gauss *out,
                             struct err *e) ERR_USE; /* gauss_free it */
/* A named blob, against its hash; *out stays empty where there is none. buf_free it. */
enum err_code ckpt_rows_blob(const struct ckpt_rows *r, const char *name, struct buf *out,
                             struct err *e) ERR_USE;
bool ckpt_rows_has(const struct ckpt_rows *r, const char *name);
/* The same into the caller's memory; ERR_FORMAT where it has not exactly so many bytes. */
enum err_code ckpt_rows_blob_to(const struct ckpt_rows *r, const char *name, void *out,
                                size_t n_bytes, struct err *e) ERR_USE;
void ckpt_rows_close(struct ckpt_rows **r);

/* ---- Gaussians in files ---- */

/* ENU (z up) -> glTF (y up): p' = (E, U, -N), rotations and SH turned with it; and back. In place.
 */
void frame_enu_to_gltf(struct gauss *g);
void frame_gltf_to_enu(struct gauss *g);

/* INRIA .ply, and on import SuperSplat's compressed one. Import finds properties by name, any
 * scalar type, skips unknown ones; SH degree from the number of f_rest. Comments "citysplat origin
 * lon lat h" are read and written (origin may be NULL; on read has_origin tells). Means are read
 * into float32 about origin_enu_m = 0 unless the file carries doubles. */
enum ply_axes { PLY_AXES_NONE, PLY_AXES_ENU, PLY_AXES_GLTF, PLY_AXES_UNKNOWN };
struct ply_info {
    bool has_origin;
    struct geo_origin origin;
    enum ply_axes
        axes; /* comment "axes ENU" or "axes glTF"; NONE: read, it said nothing; written, it is ENU
               * as every struct gauss is by default; UNKNOWN: write no comment */
};
enum err_code ply_read(const char *path, const struct codec_limits *lim, struct gauss *out,
                       struct ply_info *info, struct err *e) ERR_USE;
enum err_code ply_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct ply_info *info, struct err *e) ERR_USE;
enum err_code ply_encode(const struct gauss *g, const struct ply_info *info, struct buf *out,
                         struct err *e) ERR_USE;

/* antimatter15's .splat: no header, so nothing but its size tells. SH degree 0, frame unknown.
 * gauss_free it. */
enum err_code splat_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct gauss *out, struct err *e) ERR_USE;

/* How fine the integers are (presets.def). */
struct quant_grid {
    uint8_t position; /* log2 of steps to the median of the middle sigmas; 0: steps of 2^-12 m */
    uint8_t scale, rotation, alpha, color, sh[3], embed; /* low bits left out, 0..7 */
    uint8_t sh_degree;                                   /* higher bands are dropped */
};
enum quant_preset {
#define PRESET(id, name, about, position, scale, rotation, alpha, color, sh1, sh2, sh3, embed,     \
               degree)                                                                             \
    QUANT_##id,
#include "codec/presets.def"
#undef PRESET
    QUANT_PRESETS
};
#define QUANT_PRESET_NAMES "spz|preview|balanced|near-lossless" /* in this order, for options */
#define QUANT_PRESET_DEFAULT "balanced"   /* of what is served: a browser shows it and forgets it */
#define QUANT_PRESET_FILE "near-lossless" /* of files: others edit and convert them again */
enum { QUANT_FRAC_BITS = 12 };
const struct quant_grid *quant_preset_grid(enum quant_preset p);
const char *quant_preset_name(enum quant_preset p);

/* One quantiser for SPZ and Draco: integers of SPZ v3 (docs/formats.md). g is in the axes to be
 * written (glTF for tiles), means relative to its origin. */
struct quant { /* {0} is empty; arrays in one allocation */
    size_t n;
    uint32_t sh_degree, embed_len;
    uint32_t frac_bits; /* of positions */
    bool antialiased;
    int32_t *position;  /* [n][3], 2^-frac_bits m, in +-(2^23 - 1) */
    uint8_t *alpha;     /* [n] */
    uint8_t *color;     /* [n][3] */
    uint8_t *scale;     /* [n][3] */
    uint32_t *rotation; /* [n] SPZ v3 packed smallest-three */
    uint8_t *sh;        /* [n][K-1][3] */
    uint8_t *embed;     /* [n][embed_len] */
    float embed_min[GAUSS_EMBED_MAX], embed_max[GAUSS_EMBED_MAX];
    void *block;
};
/* Zeroed arrays for n rows. */
enum err_code quant_alloc(struct quant *q, size_t n, uint32_t sh_degree, uint32_t embed_len,
                          struct err *e) ERR_USE;
/* sh_degree may differ from g's: missing bands are 0. grid NULL: QUANT_SPZ's. Rows keep their order
 * (files are smaller when neighbours follow each other). frac_bits is 12, more where the grid asks
 * for it, fewer where the range does. ERR_DATA names the row that is not finite or has no rotation;
 * ERR_LIMIT the row that is too far from the origin for Gaussians of this size. */
enum err_code quant_from_gauss(const struct gauss *g, uint32_t sh_degree,
                               const struct quant_grid *grid, struct quant *out,
                               struct err *e) ERR_USE;
enum err_code quant_to_gauss(const struct quant *q, struct gauss *out, struct err *e) ERR_USE;
void quant_free(struct quant *q);
/* One rotation, SPZ v3: index of the largest component (x y z w) << 30 | three times sign and 9-bit
 * size. */
uint32_t quant_pack_rotation(const float quat_wxyz[4]);
void quant_unpack_rotation(uint32_t packed, float quat_wxyz[4]);

/* .spz, versions 2, 3, 4 read; 3 and 4 written. */
enum err_code spz_encode(const struct quant *q, int version, struct buf *out,
                         struct err *e) ERR_USE;
enum err_code spz_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct quant *out, struct err *e) ERR_USE;
/* .drc: sequential point cloud of integer attributes (draco_shim.cc). `tile` is text for the
 * metadata. */
enum err_code draco_encode(const struct quant *q, const char *tile, struct buf *out,
                           struct err *e) ERR_USE;
enum err_code draco_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct quant *out, struct err *e) ERR_USE;
/* .glb with KHR_gaussian_splatting: payload SPZ v3 (CesiumJS, ArcGIS, 3d-tiles-renderer + Spark)
 * ... */
enum err_code glb_encode_spz(const struct quant *q, const char *copyright, struct buf *out,
                             struct err *e) ERR_USE;
/* ... or plain float accessors (three, PlayCanvas, Babylon). g in glTF axes. */
enum err_code glb_encode_plain(const struct gauss *g, const char *copyright, struct buf *out,
                               struct err *e) ERR_USE;
/* Either form of glb: one splat primitive, no node transform, glTF axes. gauss_free it. */
enum err_code glb_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e) ERR_USE;
/* The payload back out of a glb: the .spz bytes inside (borrowed from bytes). ERR_NOENT: a plain
 * one. */
enum err_code glb_find_spz(const void *bytes, size_t n, const void **spz, size_t *n_spz,
                           struct err *e) ERR_USE;

/* Master payload of a tile in the store: float32 mean relative to the tile centre, half floats
 * elsewhere (opacity, scale and rotation float32 where lossless is set), zstd. ENU axes. */
/* Values to and from the half floats that a payload keeps: nearest even, the largest for what is
 * beyond. */
void payload_to_halves(const float *in, size_t n, uint16_t *out);
void payload_from_halves(const uint16_t *in, size_t n, float *out);
/* The rotation that a payload keeps, before its rounding. q is finite and not 0. */
void payload_unit_quat(const float q_wxyz[4], float out[4]);
/* Rows that were rounded by these give the same payload as before. */
enum err_code payload_encode(const struct gauss *g, bool lossless, struct buf *out,
                             struct err *e) ERR_USE;
enum err_code payload_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                             struct gauss *out, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif

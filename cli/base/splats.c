/* Recognises files of Gaussians by their content. The extension is used only for .splat, which has
 * no magic.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/splats.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include <jansson.h>

#include "codec/container/ckpt.h"
#include "codec/limits.h"
#include "codec/splat/draco.h"
#include "codec/splat/glb.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/splat.h"
#include "codec/splat/spz.h"
#include "lod/store/range.h"

enum { SPLATS_HEAD = 128 };

const char *splats_kind_name(enum splats_kind k)
{
    static const char *const names[] = {"unknown file", ".ply", ".spz",   ".glb",
                                        ".drc",         ".sog", ".splat", "tile store",
                                        "checkpoint",   "scene"};
    return names[k];
}

bool splats_is_sog_meta(const char *path)
{
    const char *slash = strrchr(path, '/');
    return !strcmp(slash ? slash + 1 : path, "meta.json");
}

static enum splats_kind splats_sniff(const char *path, const uint8_t *head, size_t n)
{
    const char *dot = strrchr(path, '.');
    if (n >= 4 && (!memcmp(head, "ply\n", 4) || !memcmp(head, "ply\r", 4)))
        return SPLATS_PLY;
    if (n >= 4 && !memcmp(head, "glTF", 4))
        return SPLATS_GLB;
    if ((n >= 4 && !memcmp(head, "PK\3\4", 4)) || (n && *head == '{' && splats_is_sog_meta(path)))
        return SPLATS_SOG;
    if (n >= 5 && !memcmp(head, "DRACO", 5))
        return SPLATS_DRC;
    if (n >= 16 && !memcmp(head, "SQLite format 3", 16))
        return SPLATS_STORE;
    if (n >= 4 && (!memcmp(head, "NGSP", 4) || (head[0] == 0x1f && head[1] == 0x8b)))
        return SPLATS_SPZ;
    if (dot && !strcasecmp(dot, ".ckpt"))
        return SPLATS_CKPT;
    return dot && !strcasecmp(dot, ".splat") ? SPLATS_SPLAT : SPLATS_UNKNOWN;
}

enum err_code splats_kind(const char *path, enum splats_kind *out, struct err *e)
{
    uint8_t head[SPLATS_HEAD];
    *out = SPLATS_UNKNOWN;
    if (range_is_url(path)) { /* nothing else is read from there */
        *out = SPLATS_STORE;
        return ERR_OK;
    }
    if (file_is_dir(path)) {
        char scene[FILE_PATH_MAX];
        enum err_code rc = file_join(scene, path, "scene.json", e);
        *out = !rc && file_exists(scene) ? SPLATS_SCENE : SPLATS_UNKNOWN;
        return rc;
    }
    struct stat st;
    if (!stat(path, &st) && !S_ISREG(st.st_mode)) /* what is read twice is no pipe */
        return err_set(e, ERR_FORMAT, "%s: no file, but a pipe or a device: give a file", path);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s", path);
    ssize_t n = read(fd, head, sizeof head);
    int why = errno;
    close(fd);
    errno = why;
    if (n < 0)
        return err_errno(e, ERR_IO, "%s", path);
    *out = splats_sniff(path, head, (size_t)n);
    return ERR_OK;
}

static enum err_code splats_decode(const char *path, const struct codec_limits *lim,
                                   struct splats *s, struct err *e)
{
    struct buf b = {0};
    struct quant q = {0};
    if (s->kind == SPLATS_SOG && splats_is_sog_meta(path)) {
        enum err_code rc = sog_read(path, lim, &s->g, e);
        return rc ? err_add(e, "%s", path) : ERR_OK;
    }
    enum err_code rc =
        file_read(path, lim && lim->max_bytes ? lim->max_bytes : CODEC_MAX_BYTES, &b, e);
    if (rc)
        return rc;
    if (s->kind == SPLATS_SPZ || s->kind == SPLATS_DRC) {
        rc = s->kind == SPLATS_SPZ ? spz_decode(b.data, b.size, lim, &q, e)
                                   : draco_decode(b.data, b.size, lim, &q, e);
        if (!rc)
            rc = quant_to_gauss(&q, &s->g, e);
    } else if (s->kind == SPLATS_GLB) {
        rc = glb_decode(b.data, b.size, lim, &s->g, e);
    } else if (s->kind == SPLATS_SOG) {
        rc = sog_decode(b.data, b.size, lim, &s->g, e);
    } else {
        rc = splat_decode(b.data, b.size, lim, &s->g, e);
    }
    quant_free(&q);
    buf_free(&b);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}

enum err_code splats_read(const char *path, const struct codec_limits *lim, struct splats *out,
                          struct err *e)
{
    struct ckpt c = {0};
    *out = (struct splats){0};
    enum err_code rc = splats_kind(path, &out->kind, e);
    if (rc)
        return rc;
    switch (out->kind) {
    case SPLATS_PLY:
        rc = ply_read(path, lim, &out->g, &out->info, e);
        break;
    case SPLATS_SPZ:
    case SPLATS_GLB:
    case SPLATS_DRC:
    case SPLATS_SOG:
    case SPLATS_SPLAT:
        rc = splats_decode(path, lim, out, e);
        break;
    case SPLATS_CKPT:
        rc = ckpt_read(path, &c, e);
        out->g = c.g;
        c.g = (struct gauss){0};
        ckpt_free(&c);
        break;
    case SPLATS_UNKNOWN:
    case SPLATS_STORE:
    case SPLATS_SCENE:
        rc = err_set(e, ERR_FORMAT,
                     "%s: %s; .ply, .spz, .glb, .drc, .sog, .splat or .ckpt is expected here", path,
                     out->kind == SPLATS_UNKNOWN ? "no tile store, and no file of Gaussians"
                                                 : splats_kind_name(out->kind));
        break;
    }
    if (rc)
        splats_free(out);
    return rc;
}

void splats_free(struct splats *s)
{
    gauss_free(&s->g);
    *s = (struct splats){0};
}

enum err_code splats_place(const char *option, const char *text, struct geo_origin *out,
                           struct err *e)
{
    double v[3];
    if (!number_list(text, 3, v))
        return err_set(
            e, ERR_ARG,
            "%s: '%s': longitude, latitude and height are expected, e.g. 8.6821,50.1109,160",
            option, text);
    *out = (struct geo_origin){v[0], v[1], v[2]};
    if (fabs(v[0]) > 180.0 || fabs(v[1]) > 90.0 || fabs(v[2]) > 1e6)
        return err_set(e, ERR_ARG,
                       "%s: '%s': no place on Earth (longitude first, then latitude, then metres)",
                       option, text);
    return ERR_OK;
}

enum err_code splats_name(const char *given, const char *path, char out[64], struct err *e)
{
    if (given && strlen(given) >= 64)
        return err_set(e, ERR_ARG, "--name: '%.20s...' has %zu letters, at most 63 are taken",
                       given, strlen(given));
    if (given) {
        memcpy(out, given, strlen(given) + 1);
        return ERR_OK;
    }
    const char *slash = strrchr(path, '/');
    const char *p = slash && slash[1] ? slash + 1 : path;
    size_t n = 0;
    for (; *p && *p != '.' && n + 1 < 64; p++) {
        char c = *p >= 'A' && *p <= 'Z' ? (char)(*p - 'A' + 'a') : *p;
        bool plain = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9');
        if (plain || (n > 0 && (c == '-' || c == '_')))
            out[n++] = c;
        else if (n > 0 && out[n - 1] != '-')
            out[n++] = '-';
    }
    out[n] = '\0';
    if (!n)
        snprintf(out, 64, "city");
    return ERR_OK;
}

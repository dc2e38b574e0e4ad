/* See packed.h. A 3TZ must be as citysplat export writes it: its documents name only t/Z/X/Y.glb,
 * t/Z/X/Y.lowpass.glb and tileset/Z/X/Y.json, which have routes (routes.def). The entry is read
 * when the file is opened, and all else when it is asked for.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/packed.h"

#include <ctype.h>
#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "lod/range.h"
#include "lod/remote.h"

enum { PACKED_ENTRY_MAX = 64 << 20, PACKED_DEPTH = 64, PACKED_TOGETHER = 1 << 20 };
static const char PACKED_ENTRY[] = "tileset.json";
static const double PACKED_EARTH_M = 6378137; /* from its centre to 0 N 0 E */

struct packed {
    enum packed_kind kind;
    char *path;
    struct packed_about about;
    struct read_at source;
    int fd;
    struct unzip *zip; /* PACKED_TILES */
    json_t *entry;
    struct pmtiles_read *map; /* PACKED_MAP */
    pthread_mutex_t lock;     /* for free_remote and n_free */
    /* of an address: [n_remotes], the first to ask with; those that no thread reads with */
    struct remote **remote, **free_remote;
    size_t n_remotes, n_free;
};

/* The last part of a path or address: [*n], without a query. */
static const char *packed_file(const char *path, size_t *n)
{
    const size_t all = range_is_url(path) ? strcspn(path, "?#") : strlen(path);
    const char *name = path + all;
    while (name > path && name[-1] != '/')
        name--;
    *n = (size_t)(path + all - name);
    return name;
}

static bool packed_ends(const char *name, size_t n, const char *ending)
{
    const size_t m = strlen(ending);
    return n > m && !strncasecmp(name + n - m, ending, m);
}

enum packed_kind packed_kind_of(const char *path)
{
    size_t n;
    const char *name = packed_file(path, &n);
    return packed_ends(name, n, ".3tz")       ? PACKED_TILES
           : packed_ends(name, n, ".pmtiles") ? PACKED_MAP
                                              : PACKED_NONE;
}

static enum err_code packed_name(struct packed *p, const char *path, struct err *e)
{
    size_t n;
    const char *file = packed_file(path, &n);
    while (n && file[n - 1] != '.')
        n--;
    n -= n > 0;
    bool fine = n > 0 && n < sizeof p->about.meta.name;
    for (size_t i = 0; fine && i < n; i++) {
        const char c = file[i];
        fine = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || (i && (c == '_' || c == '-'));
    }
    if (!fine)
        return err_set(e, ERR_ARG,
                       "%s: the name of the file is that of its dataset: it has at most 63 of a-z, "
                       "0-9, _ and -, and begins with a letter or digit; rename the file",
                       packed_shown(p));
    memcpy(p->about.meta.name, file, n);
    return ERR_OK;
}

/* ---- bytes ---- */

static enum err_code packed_read_file(void *user, uint64_t at, void *out, size_t n, struct err *e)
{
    const struct packed *p = user;
    for (size_t done = 0; done < n;) {
        const ssize_t got = pread(p->fd, (char *)out + done, n - done, (off_t)(at + done));
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return got ? err_errno(e, ERR_IO, "%s", p->path)
                       : err_set(e, ERR_IO, "%s: the file was cut short", p->path);
        done += (size_t)got;
    }
    return ERR_OK;
}

static enum err_code packed_read_remote(void *user, uint64_t at, void *out, size_t n, struct err *e)
{
    struct packed *p = user;
    struct remote *r = NULL;
    pthread_mutex_lock(&p->lock);
    if (p->n_free)
        r = p->free_remote[--p->n_free];
    pthread_mutex_unlock(&p->lock);
    if (!r)
        return err_set(e, ERR_INTERNAL, "%s: fewer readers than workers", packed_shown(p));
    remote_expect(r, n <= PACKED_TOGETHER ? n : 0); /* a tile; what is longer is read in order */
    enum err_code rc = remote_read(r, at, out, n, e);
    pthread_mutex_lock(&p->lock);
    p->free_remote[p->n_free++] = r;
    pthread_mutex_unlock(&p->lock);
    return rc;
}

static enum err_code packed_attach(struct packed *p, size_t readers, struct err *e)
{
    const size_t n = readers + 1;
    p->remote = mem_array(n, sizeof(struct remote *));
    p->free_remote = mem_array(n, sizeof(struct remote *));
    if (!p->remote || !p->free_remote)
        return err_set(e, ERR_MEM, "%s: out of memory", p->path);
    for (; p->n_remotes < n; p->n_remotes++) {
        enum err_code rc = remote_attach(p->fd, &p->remote[p->n_remotes], e);
        if (rc)
            return rc;
        if (p->n_remotes)
            p->free_remote[p->n_free++] = p->remote[p->n_remotes];
    }
    p->source = (struct read_at){remote_shown(p->remote[0]), remote_size(p->remote[0]), p,
                                 packed_read_remote};
    return ERR_OK;
}

static enum err_code packed_open_bytes(struct packed *p, size_t readers, struct err *e)
{
    struct stat st;
    enum err_code rc = store_open_file(p->path, &p->fd, e);
    if (!rc && range_is_url(p->path))
        return packed_attach(p, readers, e);
    if (!rc && fstat(p->fd, &st))
        rc = err_errno(e, ERR_IO, "%s", p->path);
    if (!rc)
        p->source = (struct read_at){p->path, (uint64_t)st.st_size, p, packed_read_file};
    return rc;
}

/* ---- a tileset ---- */

/* What an address of a document is, below the folder of the entry: one of the two that have
 * routes. */
static bool packed_is_ours(const char *uri)
{
    unsigned z, x, y;
    int n = 0;
    char text[80];
    const bool tile = sscanf(uri, "t/%u/%u/%u%n", &z, &x, &y, &n) == 3;
    if (!tile && sscanf(uri, "tileset/%u/%u/%u%n", &z, &x, &y, &n) != 3)
        return false;
    const bool lowpass = tile && !strcmp(uri + n, ".lowpass.glb");
    snprintf(text, sizeof text, "%s/%u/%u/%u.%s", tile ? "t" : "tileset", z, x, y,
             lowpass ? "lowpass.glb"
             : tile  ? "glb"
                     : "json"); /* numbers in their only spelling */
    return !strcmp(text, uri);
}

/* Checks what a tile of the entry and those below it name; with a prefix, puts that in front. */
static enum err_code packed_walk(const struct packed *p, json_t *tile, const char *prefix,
                                 int depth, struct err *e)
{
    json_t *content = json_object_get(tile, "content"), *uri = json_object_get(content, "uri"),
           *children = json_object_get(tile, "children"), *child;
    size_t i;
    const char *text = json_string_value(uri);
    enum err_code rc = ERR_OK;
    if (!json_is_object(tile) || depth > PACKED_DEPTH || json_object_get(tile, "contents") ||
        json_object_get(tile, "implicitTiling") || (content && (!text || !packed_is_ours(text))))
        return err_set(e, ERR_FORMAT,
                       "%s: its tileset.json is not one of citysplat export, whose tiles are "
                       "t/Z/X/Y.glb: %.60s",
                       packed_shown(p), text ? text : "no address of a tile");
    if (text && !unzip_find(p->zip, text, strlen(text)))
        return err_set(e, ERR_FORMAT, "%s: its tileset.json names %s, which is not in it",
                       packed_shown(p), text);
    if (text && prefix) {
        json_t *moved = json_sprintf("%s%s", prefix, text);
        if (json_object_set_new(content, "uri", moved))
            return err_set(e, ERR_MEM, "%s: out of memory", packed_shown(p));
    }
    json_array_foreach(children, i, child)
    {
        rc = packed_walk(p, child, prefix, depth + 1, e);
        if (rc)
            break;
    }
    return rc;
}

static enum err_code packed_numbers(const struct packed *p, const json_t *o, const char *key,
                                    size_t n, double *out, struct err *e)
{
    const json_t *list = json_object_get(o, key);
    bool fine = json_array_size(list) == n;
    for (size_t i = 0; fine && i < n; i++) {
        const json_t *v = json_array_get(list, i);
        out[i] = json_number_value(v);
        fine = json_is_number(v) && isfinite(out[i]);
    }
    return fine ? ERR_OK
                : err_set(e, ERR_FORMAT, "%s: its tileset.json has no %s of %zu numbers",
                          packed_shown(p), key, n);
}

/* Longitude, latitude, height of a place that is given from the Earth's centre. */
static enum err_code packed_geodetic(const double ecef[3], double out[3], struct err *e)
{
    const struct geo_origin at = {0, 0, 0};
    const double enu[3] = {ecef[1], ecef[2], ecef[0] - PACKED_EARTH_M};
    return geo_from_enu(&at, enu, &out[0], &out[1], &out[2], e);
}

/* Where it is, by the box of the root. */
static enum err_code packed_place(struct packed *p, const json_t *root, struct err *e)
{
    double m[16] = {0}, box[12] = {0}, at[3] = {0};
    double *bbox = p->about.bbox;
    enum err_code rc = packed_numbers(p, root, "transform", 16, m, e);
    if (!rc)
        rc = packed_numbers(p, json_object_get(root, "boundingVolume"), "box", 12, box, e);
    if (!rc)
        rc = packed_geodetic(m + 12, at, e);
    p->about.meta.origin = (struct geo_origin){at[0], at[1], at[2]};
    for (int a = 0; a < 3; a++) {
        bbox[a] = HUGE_VAL;
        bbox[a + 3] = -HUGE_VAL;
    }
    for (int corner = 0; !rc && corner < 8; corner++) {
        double local[3], ecef[3];
        for (int k = 0; k < 3; k++) {
            local[k] = box[k];
            for (int axis = 0; axis < 3; axis++)
                local[k] += box[3 + 3 * axis + k] * (corner >> axis & 1 ? 1 : -1);
        }
        for (int k = 0; k < 3; k++)
            ecef[k] = m[k] * local[0] + m[4 + k] * local[1] + m[8 + k] * local[2] + m[12 + k];
        rc = packed_geodetic(ecef, at, e);
        for (int a = 0; !rc && a < 3; a++) {
            bbox[a] = fmin(bbox[a], at[a]);
            bbox[a + 3] = fmax(bbox[a + 3], at[a]);
        }
    }
    return rc == ERR_ARG ? err_set(e, ERR_FORMAT, "%s: its tileset.json lies nowhere on the Earth",
                                   packed_shown(p))
                         : rc;
}

/* A revision is 12 hexadecimal digits: those that the export says, else of the hash. */
static void packed_revise(struct packed_about *a, const char *said)
{
    char text[33];
    hash_text(a->hash, text);
    const char *from =
        said && strlen(said) == 12 && strspn(said, "0123456789abcdef") == 12 ? said : text;
    memcpy(a->meta.revision, from, 12);
    a->meta.revision[12] = '\0';
}

static void packed_attribute(struct packed_about *a, const char *text)
{
    snprintf(a->meta.attribution, sizeof a->meta.attribution, "%s", text ? text : "");
}

static enum err_code packed_parse(struct packed *p, const struct buf *b, struct err *e)
{
    json_error_t why;
    p->entry = json_loadb((const char *)b->data, b->size, JSON_REJECT_DUPLICATES, &why);
    json_t *asset = json_object_get(p->entry, "asset");
    if (!p->entry || !asset)
        return err_set(e, ERR_FORMAT, "%s: its tileset.json is no tileset: %s", packed_shown(p),
                       p->entry ? "asset is missing" : why.text);
    const json_t *credits =
        json_object_get(json_object_get(json_object_get(asset, "extras"), "cesium"), "credits");
    packed_attribute(&p->about,
                     json_string_value(json_object_get(json_array_get(credits, 0), "html")));
    packed_revise(&p->about, json_string_value(json_object_get(asset, "tilesetVersion")));
    json_t *root = json_object_get(p->entry, "root");
    enum err_code rc = packed_walk(p, root, NULL, 0, e);
    return rc ? rc : packed_place(p, root, e);
}

static enum err_code packed_open_tiles(struct packed *p, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = unzip_open(&p->source, &p->zip, e);
    if (rc)
        return rc;
    const struct unzip_file *entry = unzip_find(p->zip, PACKED_ENTRY, sizeof PACKED_ENTRY - 1);
    if (!entry)
        return err_set(e, ERR_FORMAT, "%s: no 3TZ: it has no tileset.json", packed_shown(p));
    if (entry->plain > PACKED_ENTRY_MAX)
        return err_set(e, ERR_LIMIT, "%s: its tileset.json has more than %d MiB", packed_shown(p),
                       PACKED_ENTRY_MAX >> 20);
    size_t n;
    const struct unzip_file *file = unzip_files(p->zip, &n);
    for (size_t i = 0; i < n; i++)
        if (file[i].plain > p->about.largest_bytes)
            p->about.largest_bytes = file[i].plain;
    p->about.n_tiles = n;
    p->about.hash = unzip_hash(p->zip);
    rc = unzip_read(&p->source, entry, &b, e);
    if (!rc)
        rc = packed_parse(p, &b, e);
    buf_free(&b);
    return rc;
}

/* ---- a map ---- */

static enum err_code packed_open_map(struct packed *p, struct err *e)
{
    enum { USUAL_PX = 256 };
    struct packed_about *a = &p->about;
    enum err_code rc = pmtiles_read_open(&p->source, &p->map, e);
    if (rc)
        return rc;
    const struct pmtiles_about *m = pmtiles_read_about(p->map);
    a->hash = pmtiles_read_hash(p->map);
    a->n_tiles = pmtiles_read_count(p->map);
    a->largest_bytes = pmtiles_read_largest(p->map);
    a->zoom_min = m->zoom_min;
    a->zoom_max = m->zoom_max < KEY_ZOOM_MAX ? m->zoom_max : KEY_ZOOM_MAX;
    a->zoom_center = m->zoom_center < a->zoom_max ? m->zoom_center : a->zoom_max;
    a->format = m->type == PMTILES_PNG    ? FORMAT_PNG
                : m->type == PMTILES_JPEG ? FORMAT_JPG
                                          : FORMAT_WEBP;
    const double bbox[6] = {m->bbox_deg[0], m->bbox_deg[1], -HUGE_VAL,
                            m->bbox_deg[2], m->bbox_deg[3], HUGE_VAL};
    memcpy(a->bbox, bbox, sizeof bbox);
    a->meta.origin = (struct geo_origin){0.5 * (bbox[0] + bbox[3]), 0.5 * (bbox[1] + bbox[4]), 0};
    json_t *said = json_loads(m->metadata, JSON_REJECT_DUPLICATES, NULL);
    packed_attribute(a, json_string_value(json_object_get(said, "attribution")));
    packed_revise(a, json_string_value(json_object_get(said, "revision")));
    const json_int_t px = json_integer_value(json_object_get(said, "tileSize"));
    a->tile_px = px == 2 * (json_int_t)USUAL_PX ? 2 * USUAL_PX : USUAL_PX;
    json_decref(said);
    return ERR_OK;
}

/* ---- both ---- */

enum err_code packed_open(const char *path, size_t readers, struct packed **out, struct err *e)
{
    struct packed *p = mem_array(1, sizeof *p);
    *out = p;
    if (!p)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    p->fd = -1;
    p->kind = packed_kind_of(path);
    pthread_mutex_init(&p->lock, NULL);
    p->path = mem_text(path);
    enum err_code rc =
        p->path ? packed_open_bytes(p, readers, e) : err_set(e, ERR_MEM, "%s: out of memory", path);
    if (!rc)
        rc = packed_name(p, path, e);
    if (!rc)
        rc = p->kind == PACKED_MAP ? packed_open_map(p, e) : packed_open_tiles(p, e);
    if (rc)
        packed_close(out);
    return rc;
}

void packed_close(struct packed **out)
{
    struct packed *p = *out;
    *out = NULL;
    if (!p)
        return;
    unzip_close(&p->zip);
    pmtiles_read_close(&p->map);
    json_decref(p->entry);
    for (size_t i = 0; i < p->n_remotes; i++)
        remote_close(&p->remote[i]);
    mem_free(p->remote);
    mem_free(p->free_remote);
    if (p->fd >= 0)
        close(p->fd);
    pthread_mutex_destroy(&p->lock);
    mem_free(p->path);
    mem_free(p);
}

enum packed_kind packed_kind(const struct packed *p)
{
    return p->kind;
}

const struct packed_about *packed_about(const struct packed *p)
{
    return &p->about;
}

const char *packed_shown(const struct packed *p)
{
    return p->n_remotes ? remote_shown(p->remote[0]) : p->path;
}

enum err_code packed_entry(const struct packed *p, const char *prefix, struct buf *out,
                           struct err *e)
{
    json_t *o = json_deep_copy(p->entry);
    enum err_code rc = o ? packed_walk(p, json_object_get(o, "root"), prefix, 0, e) : ERR_MEM;
    char *text = !rc ? json_dumps(o, JSON_COMPACT | JSON_REAL_PRECISION(17)) : NULL;
    json_decref(o);
    if (!text)
        return err_set(e, ERR_MEM, "%s: out of memory for its entry", packed_shown(p));
    buf_add(out, text, strlen(text));
    free(text);
    return buf_check(out, e);
}

bool packed_find_file(const struct packed *p, const char *name, size_t n, struct packed_part *out)
{
    const struct unzip_file *f = p->zip ? unzip_find(p->zip, name, n) : NULL;
    if (f)
        *out = (struct packed_part){.name = f->name, .file = f, .size_bytes = f->plain};
    return f != NULL;
}

bool packed_find_tile(const struct packed *p, struct key k, struct packed_part *out)
{
    const uint64_t id = pmtiles_id(k.z, k.x, k.y);
    struct pmtiles_place at;
    if (!p->map || !pmtiles_read_find(p->map, id, &at))
        return false;
    *out = (struct packed_part){
        .name = hash_bytes(&at.at, sizeof at.at), .place = at, .size_bytes = at.size_bytes};
    return true;
}

enum err_code packed_read(struct packed *p, const struct packed_part *part, struct buf *out,
                          struct err *e)
{
    if (part->file)
        return unzip_read(&p->source, part->file, out, e);
    uint8_t *to = buf_grow(out, part->size_bytes);
    enum err_code rc = buf_check(out, e);
    return rc ? rc : p->source.read(p, part->place.at, to, part->size_bytes, e);
}

bool packed_replaced(const struct packed *p)
{
    return p->n_remotes && remote_changed(p->remote[0]);
}

enum err_code packed_ask(struct packed *p, double wait_s, struct err *e)
{
    return p->n_remotes ? remote_check(p->remote[0], wait_s, e) : ERR_OK;
}

/* The recipes of docs/clients.md with the words of one dataset. web/use.mjs makes the page of that
 * text when the viewer is built; here only its words in braces are replaced. A word that is none
 * of these stays: {z}, {x}, {y} of a template, {files} of one's own.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/use_page.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "core/geo/heights.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "server/base/document.h"
#include "server/data/dataset.h"
#include "server/data/encode.h"
#include "server/documents/link.h"
#include "server/documents/social_preview.h"

static const double USE_PAGE_HALF_M = 20037508.342789244; /* of EPSG:3857 */
enum { USE_PAGE_WORDS = 32, USE_PAGE_ROOM = 1400 };

struct use_page {
    size_t n;
    struct {
        const char *name;
        char *value; /* owned */
    } word[USE_PAGE_WORDS];
    bool failed;
};

static void ERR_PRINTF(3, 4)
    use_page_add(struct use_page *u, const char *name, const char *form, ...)
{
    char text[USE_PAGE_ROOM];
    va_list args;
    va_start(args, form);
    const int n = vsnprintf(text, sizeof text, form, args);
    va_end(args);
    char *value = n >= 0 && n < (int)sizeof text ? mem_text(text) : NULL;
    if (!value || u->n == USE_PAGE_WORDS) {
        u->failed = true;
        mem_free(value);
        return;
    }
    u->word[u->n].name = name;
    u->word[u->n++].value = value;
}

/* The finest tile with the most Gaussians: what single-tile recipes show, and no blur. */
static const struct store_tile *use_page_tile(const struct dataset *d)
{
    const struct store_tile *best = NULL;
    for (size_t i = 0; i < d->n_tiles; i++)
        if (tree_leaf(store_tree(d->index), i) && (!best || d->tiles[i].count > best->count))
            best = &d->tiles[i];
    return best;
}

/* A camera before a box, in metres east, up, south: what it looks at, and where it stands. */
static void use_page_camera(struct use_page *u, const double lo[3], const double hi[3])
{
    const double to[3] = {(lo[0] + hi[0]) / 2, (lo[2] + hi[2]) / 2, -(lo[1] + hi[1]) / 2};
    const double away = 0.6 * hypot(hypot(hi[0] - lo[0], hi[1] - lo[1]), hi[2] - lo[2]);
    use_page_add(u, "to", "%.0f, %.0f, %.0f", to[0], to[1], to[2]);
    use_page_add(u, "from", "%.0f, %.0f, %.0f", to[0] + 0.4 * away, to[1] + 0.6 * away,
                 to[2] + 0.9 * away);
}

static void use_page_tile_words(struct use_page *u, const struct dataset *d, const char *origin,
                                const struct store_tile *tile)
{
    const struct store_shape x = store_shape(d->index, tile);
    const struct tree_bounds b = tree_bounds(store_tree(d->index), (uint32_t)(tile - d->tiles));
    double lo[3], hi[3];
    for (int k = 0; k < 3; k++) {
        lo[k] = b.core_min_enu_m[k] - x.center_enu_m[k];
        hi[k] = b.core_max_enu_m[k] - x.center_enu_m[k];
    }
    use_page_add(u, "tile", "%s/d/%s/t/%u/%u/%u", origin, d->meta.name, tile->key.z, tile->key.x,
                 tile->key.y);
    use_page_camera(u, lo, hi);
}

/* A place in the middle of the city, on its floor, a camera that sees all of it, and its box. */
static enum err_code use_page_places(struct use_page *u, const struct dataset *d, struct err *e)
{
    const struct tree_bounds b = tree_bounds(store_tree(d->index), store_tree(d->index)->root);
    const double middle[3] = {(b.core_min_enu_m[0] + b.core_max_enu_m[0]) / 2,
                              (b.core_min_enu_m[1] + b.core_max_enu_m[1]) / 2, b.core_min_enu_m[2]};
    const double side =
        hypot(b.core_max_enu_m[0] - b.core_min_enu_m[0], b.core_max_enu_m[1] - b.core_min_enu_m[1]);
    const double rad = 3.14159265358979323846 / 180;
    double lon, lat, h, eye[5];
    enum err_code rc = geo_from_enu(&d->meta.origin, middle, &lon, &lat, &h, e);
    if (rc || !social_preview_camera(d, 1.5, eye))
        return rc ? rc : err_set(e, ERR_NOENT, "this dataset has no Gaussians");
    use_page_add(u, "lon", "%.6f", lon);
    use_page_add(u, "lat", "%.6f", lat);
    use_page_add(u, "height", "%.1f", h);
    use_page_add(u, "stand", "%.0f, %.0f, %.0f", 0.15 * side, 0.45 * side, 0.6 * side);
    use_page_add(u, "eye_lon", "%.7f", eye[0]);
    use_page_add(u, "eye_lat", "%.7f", eye[1]);
    use_page_add(u, "eye_h", "%.1f", eye[2]);
    use_page_add(u, "heading", "%.0f", eye[3]);
    use_page_add(u, "pitch", "%.0f", eye[4]);
    const double *box = d->bbox;
    use_page_add(u, "west", "%.1f", box[0] / 180 * USE_PAGE_HALF_M);
    use_page_add(u, "east", "%.1f", box[3] / 180 * USE_PAGE_HALF_M);
    use_page_add(u, "south", "%.1f", asinh(tan(box[1] * rad)) / rad / 180 * USE_PAGE_HALF_M);
    use_page_add(u, "north", "%.1f", asinh(tan(box[4] * rad)) / rad / 180 * USE_PAGE_HALF_M);
    return ERR_OK;
}

static void use_page_facts(struct use_page *u, const struct dataset *d)
{
    char words[HEIGHTS_WORDS_MAX];
    const uint64_t n = encode_city_count(d->index);
    heights_words(d->meta.heights, words);
    use_page_add(u, "heights", "%s", words);
    use_page_add(u, "attribution", "%s", d->meta.attribution[0] ? d->meta.attribution : "not said");
    use_page_add(u, "gaussians", "%llu", (unsigned long long)n);
    use_page_add(u, "megabytes", "%.1f", (double)encode_city_bytes(d->index, FORMAT_SOG) / 1e6);
}

/* The value of the word that begins at p, behind its brace; NULL: none. */
static const char *use_page_value(const struct use_page *u, const char *p, const char *end,
                                  size_t *size)
{
    for (size_t i = 0; i < u->n; i++) {
        *size = strlen(u->word[i].name);
        if ((size_t)(end - p) > *size && p[*size] == '}' && !memcmp(p, u->word[i].name, *size))
            return u->word[i].value;
    }
    return NULL;
}

static void use_page_fill(const struct use_page *u, const struct body *page, struct buf *out)
{
    const char *p = (const char *)page->data, *end = p + page->size;
    while (p < end) {
        size_t size;
        const char *value = *p == '{' ? use_page_value(u, p + 1, end, &size) : NULL;
        const char *next = memchr(p + 1, '{', (size_t)(end - p - 1));
        next = next ? next : end;
        if (value) {
            buf_markup(out, value);
            p += size + 2;
        }
        if (p < next)
            buf_add(out, p, (size_t)(next - p));
        p = next;
    }
}

enum err_code use_page_write(const struct body *page, const struct dataset *d, const char *origin,
                             const char *viewer, struct body **out, struct err *e)
{
    struct use_page u = {0};
    struct buf b = {0};
    const struct store_tile *tile = use_page_tile(d);
    enum err_code rc =
        tile ? ERR_OK
             : err_set(e, ERR_NOENT, "this dataset has no Gaussians: there is nothing to use");
    if (!rc)
        rc = use_page_places(&u, d, e);
    if (!rc) {
        use_page_add(&u, "host", "%s", origin);
        use_page_add(&u, "ds", "%s", d->meta.name);
        use_page_add(&u, "viewer", "%s/%s", origin, viewer);
        use_page_tile_words(&u, d, origin, tile);
        use_page_facts(&u, d);
        use_page_fill(&u, page, &b);
        if (u.failed)
            rc = err_set(e, ERR_MEM, "out of memory for the page of a dataset");
    }
    for (size_t i = 0; i < u.n; i++)
        mem_free(u.word[i].value);
    return document_take(rc ? rc : buf_check(&b, e), &b, out, e);
}

/* See link.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/link.h"

#include <string.h>

#include "server/data/dataset.h"

#define ROUTE(name, path, scope, cache, rate, query, on)                                           \
    static const char link_path_##name[] = path;
#include "server/route/routes.def"
#undef ROUTE

/* Bytes of the folder that addresses are relative to: that of the document about it. */
static size_t link_folder(enum link_from from)
{
    static const char *const documents[] = {[LINK_ROOT] = link_path_landing,
                                            [LINK_DATASET] = link_path_tileset_moving,
                                            [LINK_REVISION] = link_path_tileset};
    return (size_t)(strrchr(documents[from], '/') + 1 - documents[from]);
}

static void link_put_up(const char *up, struct buf *out)
{
    size_t n = strlen(up);
    while (n && up[n - 1] == '/')
        n--;
    buf_add(out, up, n);
    buf_u8(out, '/');
}

/* The value of {name}[n]. */
static void link_put_value(const struct link *l, const char *name, size_t n, struct buf *out)
{
    static const char names[] = "zxy";
    const char *at = n == 1 ? memchr(names, name[0], 3) : NULL;
    const uint32_t numbers[3] = {l->key ? l->key->z : 0, l->key ? l->key->x : 0,
                                 l->key ? l->key->y : 0};
    if (at && l->key)
        buf_printf(out, "%u", numbers[at - names]);
    else if (at && l->key_names)
        buf_printf(out, "{%s}", l->key_names[at - names]);
    else if (n == 2 && !memcmp(name, "ds", n) && l->ds)
        buf_printf(out, "%s", l->ds);
    else if (n == 3 && !memcmp(name, "rev", n) && l->rev)
        buf_printf(out, "%s%s%s", l->rev, l->edition && *l->edition ? "-" : "",
                   l->edition ? l->edition : "");
    else if (n == 3 && (!memcmp(name, "ext", n) || !memcmp(name, "fmt", n)) && l->ext)
        buf_printf(out, "%s", l->ext);
    else if (n == 3 && !memcmp(name, "row", n) && l->row)
        buf_printf(out, "%u", *l->row);
    else if (n == 4 && !memcmp(name, "seal", n) && l->seal)
        buf_printf(out, "%s", l->seal);
    else if (n == 4 && !memcmp(name, "rest", n) && l->seal)
        buf_u8(out, '/');
    else
        buf_printf(out, "{%.*s}", (int)n, name);
}

/* Behind what may be left out and begins at p: its end, where l->with is not in it. */
static const char *link_skip(const struct link *l, const char *p)
{
    const size_t n = l->with ? strlen(l->with) : 0;
    bool stays = false;
    int depth = 1;
    const char *end = p + 1;
    for (; depth; end++) {
        depth += *end == '[' ? 1 : *end == ']' ? -1 : 0;
        stays |= n && *end == '{' && !strncmp(end + 1, l->with, n) && end[n + 1] == '}';
    }
    return stays ? p + 1 : end;
}

/* The part [from, end) of a template. */
static void link_put(const struct link *l, const char *from, const char *end, struct buf *out)
{
    for (const char *p = from; p < end;) {
        if (*p == '[') {
            p = link_skip(l, p);
        } else if (*p == '{') {
            const size_t n = strcspn(p + 1, "}");
            link_put_value(l, p + 1, n, out);
            p += n + 2;
        } else {
            buf_add(out, p, *p != ']');
            p++;
        }
    }
}

static void link_write(const struct link *l, const char *path, struct buf *out)
{
    if (l->up)
        link_put_up(l->up, out);
    link_put(l, path + link_folder(l->from), path + strlen(path), out);
}

#define ROUTE(name, path, scope, cache, rate, query, on)                                           \
    void link_##name(const struct link *l, struct buf *out)                                        \
    {                                                                                              \
        link_write(l, link_path_##name, out);                                                      \
    }
#include "server/route/routes.def"
#undef ROUTE

void link_revision(const struct link *l, struct buf *out)
{
    if (l->up)
        link_put_up(l->up, out);
    link_put(l, link_path_tileset + link_folder(l->from),
             link_path_tileset + link_folder(LINK_REVISION), out);
}

struct link link_to(enum link_from from, const char *up, const struct dataset *d,
                    const char *edition)
{
    return (struct link){
        .from = from, .up = up, .ds = d->meta.name, .rev = d->meta.revision, .edition = edition};
}

const char *link_text(void (*to)(const struct link *l, struct buf *out), const struct link *l,
                      char *out, size_t room)
{
    struct buf b = {0};
    to(l, &b);
    const bool fits = !b.failed && b.size < room;
    if (fits)
        memcpy(out, b.data, b.size);
    out[fits ? b.size : 0] = '\0';
    buf_free(&b);
    return out;
}

const char *link_below_dataset(const char *target)
{
    const char *p = link_path_tileset_moving;
    for (const char *end = p + link_folder(LINK_DATASET); p < end; p++)
        if (*p == '/')
            target = strchr(target, '/') + 1;
    return target;
}

/* The end of the secret that begins at p, which is neither the address' begin nor behind its end;
 * p: there is none. */
static const char *link_secret(const char *address, const char *p)
{
    static const char sig[] = "sig=";
    const size_t n = strcspn(link_path_signed, "{"), n_sig = sizeof sig - 1;
    const size_t before = (size_t)(p - address);
    if (before >= n && !memcmp(p - n, link_path_signed, n))
        return p + strcspn(p, "/?# ");
    if (before > n_sig && !memcmp(p - n_sig, sig, n_sig) && strchr("?&", p[-1 - (int)n_sig]))
        return p + strcspn(p, "&# ");
    return p;
}

const char *link_mask(const char *address, char *out, size_t room)
{
    size_t n = 0;
    for (const char *p = address; *p && n + 2 < room;) {
        const char *end = link_secret(address, p);
        if (end > p)
            out[n++] = '-';
        p = end;
        if (*p)
            out[n++] = *p++;
    }
    out[n] = '\0';
    return out;
}

/* See social_preview.h. The page is read tag by tag: its own title, description and text without
 * scripts make way for those of the dataset, its first script is told where pictures are, and all
 * else is copied.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/social_preview.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "server/base/document.h"
#include "server/documents/home_outline.h"

/* The direction of the viewer's own first view (web/src/stage.ts). */
#define SOCIAL_PREVIEW_HEADING_DEG 20.0
#define SOCIAL_PREVIEW_PITCH_DEG (-38.0)
#define SOCIAL_PREVIEW_FOV_DEG 45.0
#define SOCIAL_PREVIEW_FILL 0.92 /* of the picture that the box of most Gaussians spans */
enum { SOCIAL_PREVIEW_WIDTH = 1200, SOCIAL_PREVIEW_HEIGHT = 630 };
static const char SOCIAL_PREVIEW_FIRST[] = "<script data-first"; /* as web/vite.config.ts has it */
static const double DEG = 3.14159265358979323846 / 180;

static double social_preview_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The nearest place, looking at the middle of a box, from which all of its corners are in sight. */
static void social_preview_stand(const double lo[3], const double hi[3], double aspect,
                                 double out_m[3])
{
    const double sh = sin(SOCIAL_PREVIEW_HEADING_DEG * DEG),
                 ch = cos(SOCIAL_PREVIEW_HEADING_DEG * DEG);
    const double sp = sin(SOCIAL_PREVIEW_PITCH_DEG * DEG), cp = cos(SOCIAL_PREVIEW_PITCH_DEG * DEG);
    const double ahead[3] = {cp * sh, cp * ch, sp}, right[3] = {ch, -sh, 0};
    const double up[3] = {-sp * sh, -sp * ch, cp};
    const double tan_y = SOCIAL_PREVIEW_FILL * tan(SOCIAL_PREVIEW_FOV_DEG / 2 * DEG),
                 tan_x = aspect * tan_y;
    double away = 0;
    for (int i = 0; i < 8; i++) {
        double v[3];
        for (int c = 0; c < 3; c++)
            v[c] = (hi[c] - lo[c]) / 2 * (i >> c & 1 ? 1 : -1);
        double need = fmax(fabs(social_preview_dot(v, right)) / tan_x,
                           fabs(social_preview_dot(v, up)) / tan_y);
        away = fmax(away, need - social_preview_dot(v, ahead));
    }
    for (int c = 0; c < 3; c++)
        out_m[c] = (lo[c] + hi[c]) / 2 - away * ahead[c];
}

bool social_preview_camera(const struct dataset *d, double aspect, double out[5])
{
    const struct tree *tree = d->index ? store_tree(d->index) : NULL;
    double at_m[3];
    if (!tree || tree->root == TREE_NONE)
        return false;
    const struct tree_bounds root = tree_bounds(tree, tree->root);
    social_preview_stand(root.core_min_enu_m, root.core_max_enu_m, aspect, at_m);
    out[3] = SOCIAL_PREVIEW_HEADING_DEG;
    out[4] = SOCIAL_PREVIEW_PITCH_DEG;
    return !geo_from_enu(&d->meta.origin, at_m, &out[0], &out[1], &out[2], NULL);
}

/* The pose of a picture of all of d, as addresses of views have it; "" if d is empty. */
static void social_preview_pose(const struct dataset *d, double aspect, char out[96])
{
    double at[5];
    out[0] = '\0';
    if (social_preview_camera(d, aspect, at))
        snprintf(out, 96, "%.7f,%.7f,%.2f@%.0f,%.0f,%.0f", at[0], at[1], at[2], at[3], at[4],
                 SOCIAL_PREVIEW_FOV_DEG);
}

void social_preview_picture(const struct dataset *d, const char *up, unsigned width_px,
                            unsigned height_px, struct buf *out)
{
    char pose[96];
    social_preview_pose(d, (double)width_px / height_px, pose);
    if (pose[0])
        buf_printf(out, "%s%sd/%s/static/%s/%ux%u.jpg", up, *up ? "/" : "", d->meta.name, pose,
                   width_px, height_px);
}

/* ---- the page ---- */

struct social_preview {
    const struct dataset *d;
    const char *origin;
    bool pictures;
    struct buf about; /* in words */
};

static void social_preview_say(struct social_preview *c)
{
    const struct store_meta *m = &c->d->meta;
    buf_printf(&c->about, "A city in 3D at %.4f° %c, %.4f° %c", fabs(m->origin.lat_deg),
               m->origin.lat_deg < 0 ? 'S' : 'N', fabs(m->origin.lon_deg),
               m->origin.lon_deg < 0 ? 'W' : 'E');
    if (m->attribution[0])
        buf_printf(&c->about, ". %s", m->attribution);
    buf_add(&c->about, "", 1);
}

static void social_preview_tag(struct buf *b, const char *kind, const char *name, const char *value)
{
    buf_printf(b, "<meta %s=\"%s\" content=\"", kind, name);
    buf_markup(b, value);
    buf_printf(b, "\" />\n");
}

static void social_preview_head(const struct social_preview *c, struct buf *b)
{
    const char *name = c->d->meta.name, *about = (const char *)c->about.data;
    struct buf url = {0};
    char size[16];
    buf_printf(b, "<title>");
    buf_markup(b, name);
    buf_printf(b, " – citysplat</title>\n");
    social_preview_tag(b, "name", "description", about);
    social_preview_tag(b, "property", "og:type", "website");
    social_preview_tag(b, "property", "og:site_name", "citysplat");
    social_preview_tag(b, "property", "og:title", name);
    social_preview_tag(b, "property", "og:description", about);
    if (*c->origin) {
        buf_printf(&url, "%s/?scene=%s", c->origin, name);
        buf_add(&url, "", 1);
        if (!url.failed)
            social_preview_tag(b, "property", "og:url", (const char *)url.data);
        url.size = 0;
    }
    if (*c->origin && c->pictures)
        social_preview_picture(c->d, c->origin, SOCIAL_PREVIEW_WIDTH, SOCIAL_PREVIEW_HEIGHT, &url);
    const bool picture = url.size > 0;
    buf_add(&url, "", 1);
    social_preview_tag(b, "name", "twitter:card", picture ? "summary_large_image" : "summary");
    if (picture && !url.failed) {
        social_preview_tag(b, "property", "og:image", (const char *)url.data);
        social_preview_tag(b, "property", "og:image:type", "image/jpeg");
        snprintf(size, sizeof size, "%d", SOCIAL_PREVIEW_WIDTH);
        social_preview_tag(b, "property", "og:image:width", size);
        snprintf(size, sizeof size, "%d", SOCIAL_PREVIEW_HEIGHT);
        social_preview_tag(b, "property", "og:image:height", size);
        social_preview_tag(b, "property", "og:image:alt", about);
    }
    buf_free(&url);
}

static void social_preview_without_scripts(const struct social_preview *c, struct buf *b)
{
    buf_printf(b, "<noscript>");
    if (c->pictures) {
        buf_printf(b, "<img src=\"");
        social_preview_picture(c->d, ".", SOCIAL_PREVIEW_WIDTH, SOCIAL_PREVIEW_HEIGHT, b);
        buf_printf(b, "\" width=\"%d\" height=\"%d\" alt=\"\" />", SOCIAL_PREVIEW_WIDTH,
                   SOCIAL_PREVIEW_HEIGHT);
    }
    buf_printf(b, "<h1>");
    buf_markup(b, c->d->meta.name);
    buf_printf(b, "</h1><p>");
    buf_markup(b, (const char *)c->about.data);
    buf_printf(b, "</p><p>Looking around needs JavaScript and WebGL 2.</p></noscript>");
}

/* What the page's first script (web/src/first.ts) needs to ask for a picture of its first view: the
 * folder of views, the origin, and the outline of what is to be seen. */
static void social_preview_first(const struct social_preview *c, struct buf *b)
{
    const struct geo_origin *at = &c->d->meta.origin;
    double outline[HOME_OUTLINE_NUMBERS];
    buf_printf(b, "%s", SOCIAL_PREVIEW_FIRST);
    if (!home_outline(c->d, outline))
        return;
    buf_printf(b, " data-still=\"./d/%s/static/\" data-origin=\"%.8f,%.8f,%.3f\" data-outline=\"",
               c->d->meta.name, at->lon_deg, at->lat_deg, at->h_m);
    for (int i = 0; i < HOME_OUTLINE_NUMBERS; i++)
        buf_printf(b, "%s%.2f", i ? "," : "", outline[i]);
    buf_printf(b, "\"");
}

static bool social_preview_begins(const char *p, const char *end, const char *word)
{
    size_t n = strlen(word);
    return (size_t)(end - p) >= n && !memcmp(p, word, n);
}

/* Behind the next `word`; `end` without one. */
static const char *social_preview_behind(const char *p, const char *end, const char *word)
{
    while (p < end && !social_preview_begins(p, end, word))
        p++;
    return p < end ? p + strlen(word) : end;
}

/* Writes what comes instead of the tag at p, and returns what is behind it. NULL: it stays. */
static const char *social_preview_replace(const struct social_preview *c, const char *p,
                                          const char *end, bool *titled, struct buf *b)
{
    if (social_preview_begins(p, end, "<meta property=\"og:") ||
        social_preview_begins(p, end, "<meta name=\"description\"")) {
        p = social_preview_behind(p, end, ">");
        return p < end && *p == '\n' ? p + 1 : p;
    }
    if (!*titled && social_preview_begins(p, end, "<title>")) {
        *titled = true;
        social_preview_head(c, b);
        return social_preview_behind(p, end, "</title>");
    }
    if (c->pictures && social_preview_begins(p, end, SOCIAL_PREVIEW_FIRST)) {
        social_preview_first(c, b);
        return p + strlen(SOCIAL_PREVIEW_FIRST);
    }
    if (social_preview_begins(p, end, "<noscript>")) {
        social_preview_without_scripts(c, b);
        return social_preview_behind(p, end, "</noscript>");
    }
    return NULL;
}

enum err_code social_preview_page(const struct body *page, const struct dataset *d,
                                  const char *origin, bool pictures, struct body **out,
                                  struct err *e)
{
    struct social_preview c = {.d = d, .origin = origin, .pictures = pictures};
    struct buf b = {0};
    bool titled = false;
    social_preview_say(&c);
    enum err_code rc = buf_check(&c.about, e);
    const char *p = (const char *)page->data, *end = p + page->size;
    while (!rc && p < end) {
        const char *next = *p == '<' ? social_preview_replace(&c, p, end, &titled, &b) : NULL;
        if (!next) {
            next = p + 1;
            while (next < end && *next != '<')
                next++;
            buf_add(&b, p, (size_t)(next - p));
        }
        p = next;
    }
    buf_free(&c.about);
    return document_take(rc, &b, out, e);
}

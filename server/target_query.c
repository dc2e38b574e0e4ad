/* Parts of a query: writing those that a target has, reading words that posted documents know as
 * well.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/target.h"

#include <stdio.h>
#include <string.h>

#include "codec/quant.h"

void target_escape(const char *text, char *out)
{
    static const char hex[] = "0123456789ABCDEF";
    for (; *text; text++) {
        unsigned char c = (unsigned char)*text;
        bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                     strchr("-._~,:=", c);
        if (plain) {
            *out++ = (char)c;
        } else {
            *out++ = '%';
            *out++ = hex[c >> 4];
            *out++ = hex[c & 15];
        }
    }
    *out = '\0';
}

void target_query(const struct target *t, char out[TARGET_QUERY_MAX])
{
    const struct form *f = &t->form;
    size_t n = 0;
    out[0] = '\0';
    if (f->preset < QUANT_PRESETS)
        n += (size_t)snprintf(out, TARGET_QUERY_MAX, "?preset=%s",
                              quant_preset_name((enum quant_preset)f->preset));
    if (f->sh_degree <= GAUSS_SH_DEGREE_MAX)
        n +=
            (size_t)snprintf(out + n, TARGET_QUERY_MAX - n, "%csh=%u", n ? '&' : '?', f->sh_degree);
    if (t->clip.n) {
        n += (size_t)snprintf(out + n, TARGET_QUERY_MAX - n, "%cclip=", n ? '&' : '?');
        target_clip_text(&t->clip, out + n);
        n += strlen(out + n);
    }
    if (t->appearance[0]) {
        n += (size_t)snprintf(out + n, TARGET_QUERY_MAX - n, "%cappearance=", n ? '&' : '?');
        target_escape(t->appearance, out + n);
    }
}

bool target_read_background(const char *text, size_t n, struct paint *out)
{
    uint32_t rgb = 0;
    out->said_background = true;
    if (n == strlen("sky") && !memcmp(text, "sky", n))
        return out->background = BACKGROUND_SKY, true;
    if (n == strlen("transparent") && !memcmp(text, "transparent", n))
        return out->background = BACKGROUND_TRANSPARENT, true;
    for (size_t i = 0; i < n; i++) {
        char c = text[i];
        int v = c >= '0' && c <= '9'   ? c - '0'
                : c >= 'a' && c <= 'f' ? c - 'a' + 10
                : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                       : -1;
        if (v < 0 || n != 6)
            return false;
        rgb = rgb * 16 + (uint32_t)v;
    }
    out->rgb = rgb;
    return n == 6;
}

bool target_read_depth(const char *text, size_t n, struct paint *out)
{
    static const char *const units[] = {
        [DEPTH_MM] = "mm", [DEPTH_CM] = "cm", [DEPTH_DM] = "dm", [DEPTH_M] = "m"};
    for (int u = DEPTH_MM; u <= DEPTH_M; u++)
        if (n == strlen(units[u]) && !memcmp(text, units[u], n))
            return out->depth = (enum depth)u, true;
    return false;
}

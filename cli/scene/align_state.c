/* The folder of an alignment, and how far it is: see align_work.h.
 *
 * state.json has what the photographs are (a hash of names and bytes), the options of the run once
 * features are sought, and the seconds of complete stages. It is written beside and renamed, and it
 * is the first file of the folder: a folder with content and without it is not ours, and is never
 * touched.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "cli/scene/align_work.h"
#include "core/pool.h"

static const char *const stage_names[ALIGN_STAGES] = {"look", "features", "matches", "model",
                                                      "again"};

size_t align_cores(const struct align *a)
{
    return a->o->threads ? (size_t)a->o->threads : pool_cores();
}

char *align_path(struct align *a, const char *below)
{
    return arena_printf(&a->arena, "%s/%s", a->dir, below);
}

void align_remove(const char *path)
{
    if (path)
        file_remove_tree(path);
}

const char *align_stage_name(enum align_stage s)
{
    return stage_names[s];
}

bool align_is_done(const struct align *a, enum align_stage s)
{
    return json_is_number(json_object_get(json_object_get(a->state, "seconds"), stage_names[s]));
}

enum err_code align_save(struct align *a, struct err *e)
{
    char *path = align_path(a, "work/state.json");
    return path ? jsonc_write(path, a->state, e) : align_no_memory(e);
}

struct align_spent align_spent_now(void)
{
    return (struct align_spent){clock_s(), clock_children_s()};
}

enum err_code align_set_done(struct align *a, enum align_stage s, const struct align_spent *start,
                             struct err *e)
{
    struct align_spent now = align_spent_now();
    json_object_set_new(json_object_get(a->state, "seconds"), stage_names[s],
                        json_real(now.clock_s - start->clock_s));
    if (!json_object_get(a->state, "processor_seconds"))
        json_object_set_new(a->state, "processor_seconds", json_object());
    json_object_set_new(json_object_get(a->state, "processor_seconds"), stage_names[s],
                        json_real(now.cpu_s - start->cpu_s));
    return align_save(a, e);
}

static void state_photos(const struct align *a, char out[33])
{
    struct hash_state *h = hash_begin();
    for (size_t i = 0; i < a->plan.n; i++) {
        const struct align_photo *p = &a->plan.photos[i];
        hash_add(h, p->name, strlen(p->name) + 1);
        hash_add(h, &p->hash, sizeof p->hash);
    }
    hash_text(hash_end(h), out);
}

/* Options that decide the result, without sizes: these are chosen once and kept. */
static void state_options(const struct align *a, char out[100])
{
    const struct align_options *o = a->o;
    int n = snprintf(out, 100, "neighbours %lld, next %lld, lens %d", (long long)o->neighbours,
                     (long long)o->next, (int)o->lens);
    if (o->mapper && n > 0 && n < 100) /* folders of older versions have no word of it */
        snprintf(out + n, 100 - (size_t)n, ", mapper %d, sigma %g", (int)o->mapper, o->gps_sigma_m);
}

void align_set_options(struct align *a)
{
    char text[100];
    state_options(a, text);
    json_object_set_new(a->state, "options", json_string(text));
    json_object_set_new(a->state, "edge_px", json_integer(a->forecast.edge_px));
    json_object_set_new(a->state, "features", json_integer(a->forecast.features));
}

static bool state_differs(const struct align *a, const char *key, long long asked)
{
    const json_t *begun = json_object_get(a->state, key);
    return asked && begun && json_integer_value(begun) != asked;
}

/* Is the state that was read of these photographs and options? */
static bool state_fits(const struct align *a)
{
    char photos[33], text[100];
    const char *was = json_string_value(json_object_get(a->state, "photographs")),
               *begun = json_string_value(json_object_get(a->state, "options"));
    state_photos(a, photos);
    state_options(a, text);
    return was && !strcmp(was, photos) && (!begun || !strcmp(begun, text)) &&
           json_is_object(json_object_get(a->state, "seconds")) &&
           !state_differs(a, "edge_px", (long long)a->o->max_edge_px) &&
           !state_differs(a, "features", (long long)a->o->features);
}

/* Nothing in it, but what a run leaves that is killed before it writes its state. */
static bool state_is_empty(const char *dir, const char *allowed)
{
    DIR *d = opendir(dir);
    bool empty = true;
    for (struct dirent *t; empty && d && (t = readdir(d));)
        empty = !strcmp(t->d_name, ".") || !strcmp(t->d_name, "..") ||
                !strncmp(t->d_name, allowed, strlen(allowed));
    if (d)
        closedir(d);
    return empty;
}

static enum err_code state_begin(struct align *a, struct err *e)
{
    static const char *const ours[] = {"sparse", "logs", "align.json", "work"};
    char photos[33], *work = align_path(a, "work");
    for (size_t k = 0; k < sizeof ours / sizeof *ours; k++)
        align_remove(align_path(a, ours[k]));
    state_photos(a, photos);
    json_decref(a->state);
    a->state =
        json_pack("{s:s, s:{}, s:{}}", "photographs", photos, "seconds", "processor_seconds");
    if (!a->state || !work)
        return align_no_memory(e);
    enum err_code rc = file_mkdir(work, e);
    return rc ? rc : align_save(a, e);
}

enum err_code align_open(struct align *a, struct err *e)
{
    char *path = align_path(a, "work/state.json"), *work = align_path(a, "work"),
         *logs = align_path(a, "logs");
    if (!path || !work || !logs)
        return align_no_memory(e);
    bool ours = file_exists(path), fits = false;
    if (ours && jsonc_read(path, &a->state, NULL))
        a->state = NULL; /* damaged: it fits nothing */
    fits = ours && state_fits(a);
    if (ours && !fits && !a->o->overwrite)
        return err_set(e, ERR_ARG,
                       "%s: made with other photographs or options; give another -o, or "
                       "--overwrite to begin anew",
                       a->dir);
    if (!ours && file_exists(a->dir) &&
        !(file_is_dir(a->dir) && state_is_empty(a->dir, "work") &&
          state_is_empty(work, "state.json.part")))
        return err_set(e, ERR_ARG, "%s: is there already, and not of align; give another -o",
                       a->dir);
    enum err_code rc = fits ? ERR_OK : state_begin(a, e);
    return rc ? rc : file_mkdir(logs, e);
}

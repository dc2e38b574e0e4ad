/* citysplat city: photographs to a tile store, by the commands that exist for each step.
 *
 * Each step is a process of its own, so its memory is free for the next one. What a step has
 * finished is kept, and what was trained is never removed unasked:
 *
 *   DIR/align/            poses, unless the folder has COLMAP's model (citysplat align)
 *   DIR/scene/            the scene (ingest), depths (stereo), what was trained (train)
 *   DIR/ingest.options    what the scene was made with, and of
 *   DIR/NAME.tiles        the store (tile)
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <jansson.h>

#include "cli/base/cli.h"
#include "cli/city.h"
#include "cli/city_inputs.h"
#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "scene/ingest/ingest_files.h"
#include "scene/stereo/depths.h"

enum { CITY_ARGS = 48, CITY_NAP_MS = 50, CITY_GPS_LEAST = 3 };

static const struct options_def city_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct city_options, __VA_ARGS__)
#include "cli/city.def"
};

static const struct options_spec city_spec = {
    .command = "city",
    .usage = "citysplat city FOLDER -o DIR [options]\n"
             "       citysplat city FOLDER --dry-run",
    .about = "Makes a city from a folder: of photographs alone, or with photographs in images/ and "
             "COLMAP's model in sparse/. Runs align, ingest, stereo, train and tile, and goes on "
             "where an earlier run stopped. --dry-run prints the forecast alone.",
    .example = "citysplat city photos --dry-run\ncitysplat city photos -o town",
    .defs = city_defs,
    .n_defs = sizeof city_defs / sizeof *city_defs,
    .min_args = 1,
    .max_args = 1,
};

static enum err_code city_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "city: out of memory");
}

static void city_say(const char *text, const char *what)
{
    fprintf(stderr, "== %s%s\n", text, what);
}

static char *city_path(struct city *c, const char *below)
{
    return arena_printf(&c->arena, "%s/%s", c->o->output, below);
}

/* ---- a step ---- */

struct city_step {
    const char *argv[CITY_ARGS]; /* argv[1] is the command */
    size_t n;
};

static void city_begin(struct city_step *s, const char *command)
{
    *s = (struct city_step){.argv = {"citysplat", command}, .n = 2};
}

/* A NULL value leaves the flag out. */
static void city_add(struct city_step *s, const char *flag, const char *value)
{
    if (!value || s->n + 3 > CITY_ARGS)
        return;
    s->argv[s->n++] = flag;
    s->argv[s->n++] = value;
}

static void city_word(struct city_step *s, const char *word)
{
    if (word && s->n + 2 <= CITY_ARGS)
        s->argv[s->n++] = word;
}

/* Waits for it, and asks it to stop when we are. */
static int city_wait(pid_t pid)
{
    int status = 0;
    bool told = false;
    const struct timespec nap = {.tv_nsec = CITY_NAP_MS * 1000000L};
    for (;;) {
        pid_t got = waitpid(pid, &status, WNOHANG);
        if (got == pid || (got < 0 && errno != EINTR))
            return status;
        if (signals_stopping() && !told) {
            told = true;
            kill(pid, SIGTERM);
        }
        nanosleep(&nap, NULL);
    }
}

/* Runs this program as another command. What it has finished is finished, also if we are to stop.
 */
static enum err_code city_run(const struct city_step *s, struct err *e)
{
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped; the same command goes on");
    pid_t parent = getpid(), pid = fork();
    if (pid == 0) {
        union { /* exec promises not to write to them, in a type older than const */
            const char *const *from;
            char *const *to;
        } args = {.from = s->argv};
        setpgid(0, 0); /* Ctrl-C reaches it once, from us */
        prctl(PR_SET_PDEATHSIG, SIGTERM);
        if (getppid() == parent)
            execv("/proc/self/exe", args.to);
        _exit(127);
    }
    if (pid < 0)
        return err_errno(e, ERR_IO, "cannot start citysplat %s", s->argv[1]);
    int status = city_wait(pid), exit = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    if (exit == 0)
        return ERR_OK;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped; the same command goes on");
    if (exit < 0)
        return err_set(e, ERR_DATA, "citysplat %s: killed by signal %d; the same command goes on",
                       s->argv[1], WTERMSIG(status));
    return err_set(e, exit == 2 ? ERR_ARG : ERR_DATA, "citysplat %s failed, as said above",
                   s->argv[1]);
}

/* ---- poses ---- */

static bool city_is_newer(const char *path, const struct stat *than)
{
    struct stat st;
    if (stat(path, &st))
        return true;
    return st.st_mtim.tv_sec != than->st_mtim.tv_sec ? st.st_mtim.tv_sec > than->st_mtim.tv_sec
                                                     : st.st_mtim.tv_nsec > than->st_mtim.tv_nsec;
}

/* Whether photographs without a pose might get one in the minutes that are given now. */
static bool city_may_place_more(const struct city *c, const char *result)
{
    json_t *root = NULL;
    if (jsonc_read(result, &root, NULL))
        return false;
    const json_t *minutes = json_object_get(json_object_get(root, "config"), "minutes");
    const bool more = json_array_size(json_object_get(root, "unplaced")) > 0 &&
                      json_is_number(minutes) && json_number_value(minutes) < c->o->minutes;
    json_decref(root);
    return more;
}

/* Poses are there, and no photograph came after them. */
static enum err_code city_has_poses(struct city *c, const char *result, bool *has, struct err *e)
{
    struct ingest_files files;
    struct stat made;
    char path[FILE_PATH_MAX];
    *has = !stat(result, &made) && !city_may_place_more(c, result);
    if (!*has)
        return ERR_OK;
    enum err_code rc = ingest_files_list(c->images, &files, e);
    for (size_t i = 0; !rc && *has && i < files.n; i++) {
        rc = file_join(path, c->images, files.names[i], e);
        *has = !rc && !city_is_newer(path, &made);
    }
    ingest_files_free(&files);
    return rc;
}

/* Without GPS nobody knows where the city lies, nor how large it is; with too little of it somebody
 * has to decide. Ingest says so too, but after the poses. */
static enum err_code city_has_place(const struct city *c, struct err *e)
{
    struct ingest_files files;
    char path[FILE_PATH_MAX];
    const struct city_options *o = c->o;
    size_t n = 0, n_gps = 0;
    if (o->gcp || o->positions || (o->origin && o->metres_per_unit))
        return ERR_OK;
    enum err_code rc = ingest_files_list(c->images, &files, e);
    for (size_t i = 0; !rc && i < files.n; i++) {
        struct image_gps gps = {0};
        struct drone_meta drone;
        uint32_t size[2];
        rc = file_join(path, c->images, files.names[i], e);
        if (rc || image_read_info(path, &size[0], &size[1], &gps, &drone, NULL))
            continue; /* align names it */
        n++;
        n_gps += gps.has_position && gps.has_altitude;
    }
    ingest_files_free(&files);
    if (rc || !n || 2 * n_gps >= n)
        return rc;
    if (n_gps >= CITY_GPS_LEAST)
        return err_set(
            e, ERR_DATA,
            "%s: %zu of %zu photographs have a GPS position with altitude, too few to place the "
            "city: give ground control points (--gcp) or positions of the photographs "
            "(--positions), or place it by hand with --origin LON,LAT,H and --metres-per-unit",
            c->images, n_gps, n);
    log_warn("city",
             "%zu of %zu photographs have a GPS position with altitude: the city will have no "
             "%s. Ground control points (--gcp) or positions of the photographs (--positions) "
             "give both",
             n_gps, n,
             o->metres_per_unit ? "place"
             : o->origin        ? "metres"
                                : "place and no metres");
    return ERR_OK;
}

static enum err_code city_align(struct city *c, struct err *e)
{
    struct city_step s;
    char *model = city_path(c, "align"), *result = city_path(c, "align/align.json");
    bool has = false;
    if (c->sparse)
        return ERR_OK;
    if (!model || !result || !(c->sparse = city_path(c, "align/sparse")))
        return city_no_memory(e);
    enum err_code rc = city_has_poses(c, result, &has, e);
    if (rc)
        return rc;
    if (has) {
        city_say("1/5 the poses are there already: ", model);
        return ERR_OK;
    }
    if ((rc = city_has_place(c, e)))
        return rc;
    city_say("1/5 align: poses of the photographs, by COLMAP", "");
    city_begin(&s, "align");
    city_word(&s, c->images);
    city_add(&s, "-o", model);
    city_add(&s, "--minutes", arena_printf(&c->arena, "%.17g", c->o->minutes));
    city_word(&s, c->o->overwrite ? "--overwrite" : NULL);
    return city_run(&s, e);
}

/* ---- the scene ---- */

static enum err_code city_ingest(struct city *c, struct err *e)
{
    const struct city_options *o = c->o;
    struct city_step s;
    struct buf told = {0}, was = {0};
    char *scene = city_path(c, "scene"), *made = city_path(c, "scene/scene.json"),
         *path = city_path(c, "ingest.options"),
         *edge = arena_printf(&c->arena, "%lld", (long long)o->max_edge_px);
    if (!scene || !made || !path || !edge)
        return city_no_memory(e);
    city_begin(&s, "ingest");
    city_word(&s, c->images);
    city_word(&s, c->sparse);
    city_add(&s, "--max-edge-px", edge);
    city_add(&s, "--origin", o->origin);
    city_add(&s, "--metres-per-unit", o->metres_per_unit);
    city_add(&s, "--ground-h", o->ground_h);
    city_add(&s, "--gcp", o->gcp);
    city_add(&s, "--gcp-epsg", o->gcp_epsg);
    city_add(&s, "--check", o->check);
    city_add(&s, "--positions", o->positions);
    city_add(&s, "--heights", o->heights);
    city_add(&s, "--geoid", o->geoid);
    city_add(&s, "--mask-dir", o->masks);
    city_add(&s, "--attribution", o->attribution);
    enum err_code rc = city_inputs_tell(s.argv + 2, s.n - 2, &told, e);
    bool there = file_exists(made) && !o->overwrite;
    if (!rc && there && file_exists(path))
        rc = file_read(path, 0, &was, e);
    if (!rc && there)
        rc = city_inputs_same(scene, &was, &told, e);
    if (!rc)
        city_say(there ? "2/5 the scene is there already: "
                       : "2/5 ingest: poses and GPS into metres, east-north-up: ",
                 scene);
    city_add(&s, "-o", scene);
    city_word(&s, o->overwrite ? "--overwrite" : NULL);
    if (!rc && !there) /* first: a scene without it would never be taken up again */
        rc = file_write(path, told.data, told.size, e);
    if (!rc && !there)
        rc = city_run(&s, e);
    buf_free(&was);
    buf_free(&told);
    return rc;
}

/* Whether photographs have neighbours at all. */
static enum err_code city_has_depths(const char *dir, bool *has, struct err *e)
{
    struct scene scene = {0};
    enum err_code rc = scene_read(dir, &scene, e);
    if (!rc)
        rc = depths_possible(&scene, has, e);
    scene_free(&scene);
    return rc;
}

/* Depths of photographs from their neighbours. Where photographs have none, training goes without.
 */
static enum err_code city_stereo(struct city *c, struct err *e)
{
    struct city_step s;
    char *scene = city_path(c, "scene"), *made = city_path(c, "scene/depth/depths.json");
    bool has = false;
    if (!scene || !made)
        return city_no_memory(e);
    if (file_exists(made))
        return ERR_OK;
    enum err_code rc = city_has_depths(scene, &has, e);
    if (rc)
        return rc;
    if (!has) {
        city_say("3/5 no photograph has a neighbour: training goes on without depths", "");
        return ERR_OK;
    }
    city_say("3/5 stereo: depths of the photographs from their neighbours", "");
    city_begin(&s, "stereo");
    city_word(&s, scene);
    return city_run(&s, e);
}

/* ---- training and tiles ---- */

/* Whether any cell has DIR/scene/cells/ID/`name`, newer than the other if there is one. */
static bool city_cells_have(struct city *c, const char *name, const struct stat *newer_than)
{
    char *cells = city_path(c, "scene/cells"), path[FILE_PATH_MAX];
    DIR *d = cells ? opendir(cells) : NULL;
    bool found = false;
    for (struct dirent *t; !found && d && (t = readdir(d));) {
        int n = snprintf(path, sizeof path, "%s/%s/%s", cells, t->d_name, name);
        found = t->d_name[0] != '.' && n > 0 && (size_t)n < sizeof path && file_exists(path) &&
                (!newer_than || city_is_newer(path, newer_than));
    }
    if (d)
        closedir(d);
    return found;
}

static enum err_code city_train(struct city *c, struct err *e)
{
    struct city_step s;
    bool resume = city_cells_have(c, "resume.ckpt", NULL);
    char *scene = city_path(c, "scene"),
         *steps = arena_printf(&c->arena, "%lld", (long long)c->o->iterations);
    if (!scene || !steps)
        return city_no_memory(e);
    city_say(resume ? "4/5 train: a training was interrupted: it goes on"
                    : "4/5 train: Gaussians at three levels of detail",
             "");
    city_begin(&s, "train");
    city_word(&s, scene);
    city_add(&s, "--iterations", steps);
    city_word(&s, "--final-all"); /* nobody looks for gaps where photographs were kept for scores */
    city_word(&s, resume ? "--resume" : NULL);
    return city_run(&s, e);
}

/* The store, unless it is younger than all that was trained. */
static enum err_code city_tile(struct city *c, struct err *e)
{
    struct city_step s;
    struct stat made;
    char *scene = city_path(c, "scene"), *fresh = city_path(c, "new.tiles"),
         *store = arena_printf(&c->arena, "%s/%s.tiles", c->o->output, c->name);
    if (!scene || !fresh || !store)
        return city_no_memory(e);
    bool there = !stat(store, &made) && !city_cells_have(c, "done.json", &made);
    city_say(there ? "5/5 the tiles are there already: "
                   : "5/5 tile: the z/x/y pyramid in one file: ",
             store);
    enum err_code rc = ERR_OK;
    if (!there) {
        city_begin(&s, "tile");
        city_word(&s, scene);
        city_add(&s, "--name", c->name);
        city_add(&s, "-o", fresh);
        city_word(&s, "--overwrite"); /* of a run that was killed */
        rc = city_run(&s, e);
        if (!rc && rename(fresh, store))
            rc = err_errno(e, ERR_IO, "%s: cannot rename", fresh);
    }
    city_begin(&s, "info");
    city_word(&s, store);
    if (!rc)
        rc = city_run(&s, e);
    if (!rc)
        printf(
            "names    %s, of -o, has all that was made and may be renamed; %s, %s, is the name of "
            "the store and of the city in addresses\n"
            "next     citysplat serve %s\n",
            c->o->output, c->name, c->o->name ? "of --name" : "made of it, or of --name", store);
    return rc;
}

/* ---- the whole ---- */

/* Photographs and model in a folder. */
static enum err_code city_open(struct city *c, const char *folder, struct err *e)
{
    char path[FILE_PATH_MAX], real[FILE_PATH_MAX];
    if (!file_is_dir(folder) || !realpath(folder, real))
        return err_set(e, ERR_NOENT,
                       "%s: a folder is expected, of photographs, or with images/ and COLMAP's "
                       "sparse/ in it",
                       folder);
    enum err_code rc = file_join(path, real, "images", e);
    if (!rc)
        c->images = arena_text(&c->arena, file_is_dir(path) ? path : real);
    if (!rc)
        rc = file_join(path, real, "sparse", e);
    if (!rc && file_is_dir(path) && !(c->sparse = arena_text(&c->arena, path)))
        rc = city_no_memory(e);
    return rc || c->images ? rc : city_no_memory(e);
}

/* Letters that tile takes. */
static void city_choose_name(struct city *c)
{
    size_t n = strlen(c->o->output);
    while (n && c->o->output[n - 1] == '/')
        n--;
    size_t from = n;
    while (from && c->o->output[from - 1] != '/')
        from--;
    snprintf(c->name, sizeof c->name, "%.*s", (int)(n - from), c->o->output + from);
    for (char *p = c->name; *p; p++)
        *p = (*p >= 'A' && *p <= 'Z') ? *p - 'A' + 'a'
             : (*p >= 'a' && *p <= 'z') || (*p >= '0' && *p <= '9') || strchr("-_", *p) ? *p
                                                                                        : '-';
    if (!c->name[0])
        snprintf(c->name, sizeof c->name, "city");
}

static enum err_code city_all(struct city *c, struct err *e)
{
    if (c->o->name)
        snprintf(c->name, sizeof c->name, "%s", c->o->name);
    else
        city_choose_name(c);
    enum err_code rc = file_mkdir(c->o->output, e);
    if (!rc)
        rc = city_align(c, e);
    if (!rc)
        rc = city_ingest(c, e);
    if (!rc)
        rc = city_stereo(c, e);
    if (!rc)
        rc = city_train(c, e);
    return rc ? rc : city_tile(c, e);
}

enum err_code cli_city(int argc, char **argv, struct err *e)
{
    struct city_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct city c = {.o = &o};
    enum err_code rc = options_parse(&city_spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run && !o.output && !o.dry_run)
        rc = err_set(e, ERR_ARG, "-o is missing: the folder of the results; or --dry-run");
    if (run && !rc)
        rc = city_open(&c, args.arg[0], e);
    if (run && !rc) {
        signals_catch();
        setvbuf(stdout, NULL, _IOLBF, 0); /* lines of several processes stay in order */
        rc = o.dry_run ? city_forecast(&c, e) : city_all(&c, e);
    }
    arena_free(&c.arena);
    arena_free(&arena);
    return rc;
}

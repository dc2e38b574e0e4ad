/* The help of a command as text, Markdown and mdoc (core/options/options_help.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/options/options_help.h"

#include <ctype.h>
#include <string.h>

enum { OPTIONS_HELP_COLUMN = 34, OPTIONS_HELP_WIDTH = 100, OPTIONS_HELP_MDOC_WIDTH = 76 };

static const struct options_help_always {
    enum options_tier tier;
    const char *flag, *value, *about;
} options_help_always[] = {
    {OPTIONS_EVERYDAY, "--config", "FILE",
     "read options from a .jsonc file; later files and flags win"},
    {OPTIONS_MORE, "--print-config", "", "print the resolved options as JSON and stop"},
    {OPTIONS_MORE, "-v", "", "print more log lines"},
    {OPTIONS_EVERYDAY, "-q", "", "print no progress, only warnings and errors"},
    {OPTIONS_MORE, "-h, --help", "", "print the everyday options"},
    {OPTIONS_MORE, "--help=all", "", "print all options"},
};
enum { OPTIONS_HELP_ALWAYS = sizeof options_help_always / sizeof *options_help_always };
static const char options_help_always_title[] = "of every command";

void options_help_flag(const char *key, char out[OPTIONS_NAME_MAX])
{
    size_t i = 0;
    for (; key[i] && i + 1 < OPTIONS_NAME_MAX; i++)
        out[i] = key[i] == '_' ? '-' : key[i];
    out[i] = '\0';
}

static bool options_help_is_on(const struct options_def *d)
{
    return d->type == OPTIONS_BOOL && !strcmp(d->def, "true");
}

void options_help_shown_flag(const struct options_def *d, char out[OPTIONS_NAME_MAX + 4])
{
    char flag[OPTIONS_NAME_MAX];
    options_help_flag(d->key, flag);
    snprintf(out, OPTIONS_NAME_MAX + 4, "%s%s", options_help_is_on(d) ? "no-" : "", flag);
}

/* What stands behind the flag: a unit, the choices, or a letter; "" for a switch. */
static const char *options_help_value(const struct options_def *d)
{
    if (d->type == OPTIONS_BOOL)
        return "";
    if (d->type == OPTIONS_INTS || d->type == OPTIONS_NUMS)
        return "A,B,...";
    if (*d->unit)
        return d->unit;
    return d->type == OPTIONS_INT ? "N" : "X";
}

static bool options_help_has_range(const struct options_def *d)
{
    return d->type == OPTIONS_NUM || d->type == OPTIONS_INT || d->type == OPTIONS_INTS ||
           d->type == OPTIONS_NUMS;
}

/* ---- text ---- */

/* Words of `text` from `column` on, in lines of OPTIONS_HELP_WIDTH that begin at `indent`. */
static void options_help_wrapped(FILE *f, const char *text, size_t column, size_t indent)
{
    for (bool first = true; *text; first = false) {
        size_t n = strcspn(text, " ");
        bool breaks = !first && column + 1 + n > OPTIONS_HELP_WIDTH;
        if (breaks)
            fprintf(f, "\n%*s", (int)indent, "");
        else if (!first)
            putc(' ', f);
        column = (breaks ? indent : column + !first) + n;
        fprintf(f, "%.*s", (int)n, text);
        text += n + strspn(text + n, " ");
    }
    putc('\n', f);
}

static void options_help_text_one(FILE *f, const struct options_def *d)
{
    char flag[OPTIONS_NAME_MAX + 4], head[160], tail[600];
    options_help_shown_flag(d, flag);
    const char *value = options_help_value(d);
    snprintf(head, sizeof head, "  --%s%s%s", flag, *value ? " " : "", value);
    const char *quote = d->type == OPTIONS_BOOL || !*d->def ? NULL : d->def;
    /* The help says what the option does; where it is on, the flag that is shown turns it off. */
    snprintf(tail, sizeof tail, "%s%s%s%s%s", options_help_is_on(d) ? "Turn off: " : "", d->help,
             quote ? " [" : "", quote ? quote : "", quote ? "]" : "");
    fprintf(f, "%-*s", OPTIONS_HELP_COLUMN, head);
    if (strlen(head) >= OPTIONS_HELP_COLUMN) /* no space is left before the text */
        fprintf(f, "\n%*s", OPTIONS_HELP_COLUMN, "");
    options_help_wrapped(f, tail, OPTIONS_HELP_COLUMN, OPTIONS_HELP_COLUMN);
}

/* Options of heading `at` (its row, or 0 for those before any heading) that belong to `tier`. */
static size_t options_help_count(const struct options_spec *spec, size_t at, enum options_tier tier)
{
    size_t n = 0, i = at + (at < spec->n_defs && spec->defs[at].type == OPTIONS_GROUP);
    for (; i < spec->n_defs && spec->defs[i].type != OPTIONS_GROUP; i++)
        n += spec->defs[i].tier == tier;
    return n;
}

/* "81 more: optimizer 14, of every command 4; `citysplat train --help=all` shows them" */
static void options_help_more(FILE *f, const struct options_spec *spec)
{
    char text[1600];
    size_t n = 0, always = 0, at = 0;
    for (size_t i = 0; i < spec->n_defs; i++)
        n += spec->defs[i].type != OPTIONS_GROUP && spec->defs[i].tier == OPTIONS_MORE;
    for (size_t i = 0; i < OPTIONS_HELP_ALWAYS; i++)
        always += options_help_always[i].tier == OPTIONS_MORE;
    at += (size_t)snprintf(text, sizeof text, "%zu more", n + always);
    const char *before = ": ";
    for (size_t i = 0; i < spec->n_defs; i++) {
        const struct options_def *d = &spec->defs[i];
        bool heads = d->type == OPTIONS_GROUP;
        size_t more = heads || !i ? options_help_count(spec, i, OPTIONS_MORE) : 0;
        const char *title = heads ? d->help : "of this command";
        if (!more || at >= sizeof text)
            continue;
        at += (size_t)snprintf(text + at, sizeof text - at, "%s%.*s %zu", before,
                               (int)strcspn(title, "(:"), title, more);
        before = ", ";
    }
    if (at < sizeof text)
        snprintf(text + at, sizeof text - at, "%s%s %zu; `%.*s %s --help=all` shows them", before,
                 options_help_always_title, always, (int)strcspn(spec->usage, " "), spec->usage,
                 spec->command);
    putc('\n', f);
    options_help_wrapped(f, text, 0, 0);
}

static void options_help_text_always(FILE *f, bool all)
{
    fprintf(f, "\n%s:\n", options_help_always_title);
    for (size_t i = 0; i < OPTIONS_HELP_ALWAYS; i++) {
        const struct options_help_always *a = &options_help_always[i];
        char head[80];
        if (!all && a->tier == OPTIONS_MORE)
            continue;
        snprintf(head, sizeof head, "  %s %s", a->flag, a->value);
        fprintf(f, "%-*s%s\n", OPTIONS_HELP_COLUMN, head, a->about);
    }
}

static void options_help_text(FILE *f, const struct options_spec *spec, bool all)
{
    fprintf(f, "usage: %s\n\n", spec->usage);
    options_help_wrapped(f, spec->about, 0, 0);
    if (spec->n_defs)
        fprintf(f, "\noptions (defaults in brackets):\n");
    for (size_t i = 0; i < spec->n_defs; i++)
        if (spec->defs[i].type == OPTIONS_GROUP) {
            if (all || options_help_count(spec, i, OPTIONS_EVERYDAY))
                fprintf(f, "\n%s:\n", spec->defs[i].help);
        } else if (all || spec->defs[i].tier == OPTIONS_EVERYDAY)
            options_help_text_one(f, &spec->defs[i]);
    options_help_text_always(f, all);
    if (!all)
        options_help_more(f, spec);
    if (!spec->example)
        return;
    fprintf(f, "\nexample:\n");
    for (const char *p = spec->example; *p; p += strcspn(p, "\n"), p += *p == '\n')
        fprintf(f, "  %.*s\n", (int)strcspn(p, "\n"), p);
}

/* ---- Markdown ---- */

/* A cell of a table, or a paragraph: what Markdown would read as a mark is escaped. */
static void options_help_md_text(FILE *f, const char *text)
{
    bool code = false;
    for (; *text; text++) {
        code ^= *text == '`';
        if (*text == '|' || (!code && strchr("<*_[]", *text)))
            putc('\\', f);
        putc(*text, f);
    }
}

static void options_help_md_head(FILE *f, const char *title)
{
    if (title)
        fprintf(f, "\n### %c%s\n", toupper((unsigned char)*title), title + 1);
    fprintf(f, "\n| option | tier | default | range | what |\n|---|---|---|---|---|\n");
}

static void options_help_md_one(FILE *f, const struct options_def *d)
{
    char flag[OPTIONS_NAME_MAX + 4];
    options_help_shown_flag(d, flag);
    const char *value = options_help_value(d);
    fprintf(f, "| `--%s", flag);
    if (*value) {
        fprintf(f, "` *");
        options_help_md_text(f, value);
        putc('*', f);
    } else {
        putc('`', f);
    }
    fprintf(f, " | %s | ", d->tier == OPTIONS_EVERYDAY ? "everyday" : "more");
    if (d->type != OPTIONS_BOOL)
        options_help_md_text(f, d->def);
    fprintf(f, " | ");
    if (options_help_has_range(d))
        fprintf(f, "%.15g to %.15g", d->lo, d->hi);
    fprintf(f, " | %s", options_help_is_on(d) ? "Turn off: " : "");
    options_help_md_text(f, d->help);
    fprintf(f, " |\n");
}

static void options_help_markdown(FILE *f, const struct options_spec *spec)
{
    fprintf(f, "\n## citysplat %s\n\n```\n", spec->command);
    for (const char *p = spec->usage; *p; p += strcspn(p, "\n"), p += *p == '\n') {
        p += strspn(p, " ");
        fprintf(f, "%.*s\n", (int)strcspn(p, "\n"), p);
    }
    fprintf(f, "```\n\n");
    options_help_md_text(f, spec->about);
    putc('\n', f);
    if (spec->example)
        fprintf(f, "\n```sh\n%s\n```\n", spec->example);
    for (size_t i = 0; i < spec->n_defs; i++)
        if (spec->defs[i].type == OPTIONS_GROUP) {
            options_help_md_head(f, spec->defs[i].help);
        } else {
            if (!i)
                options_help_md_head(f, NULL);
            options_help_md_one(f, &spec->defs[i]);
        }
}

/* ---- mdoc ---- */

/* A date of the page, which mdoc insists on: that of the version. */
static const char options_help_date[] = CITYSPLAT_DATE;

static void options_help_mdoc_chars(FILE *f, const char *text, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (text[i] == '\\')
            fputs("\\e", f);
        else
            putc(text[i], f);
}

/* Lines are short, sentences begin on lines of their own, as mdoc wants it. */
void options_help_mdoc_text(FILE *f, const char *text)
{
    size_t column = 0;
    bool ends = false; /* the word before ends a sentence */
    while (*text) {
        size_t n = strcspn(text, " ");
        bool begins = ends && isupper((unsigned char)*text);
        if (column && (begins || column + 1 + n > OPTIONS_HELP_MDOC_WIDTH)) {
            putc('\n', f);
            column = 0;
        } else if (column) {
            putc(' ', f);
            column++;
        }
        if (!column && (*text == '.' || *text == '\''))
            fputs("\\&", f);
        options_help_mdoc_chars(f, text, n);
        column += n;
        ends = n && text[n - 1] == '.';
        text += n + strspn(text + n, " ");
    }
    putc('\n', f);
}

void options_help_mdoc_head(FILE *f, const char *page, const char *about)
{
    fprintf(f, ".Dd %s\n.Dt ", options_help_date);
    for (const char *p = page; *p; p++)
        putc(toupper((unsigned char)*p), f);
    fprintf(f, " 1\n.Os\n.Sh NAME\n.Nm %s\n.Nd ", page);
    options_help_mdoc_text(f, about);
}

/* A word of the usage line: an option, or an argument; brackets stand apart. */
static void options_help_mdoc_word(FILE *f, const char *word, size_t n)
{
    bool opens = n > 1 && strchr("([", word[0]), closes = n > 1 && strchr(")]", word[n - 1]);
    if (strchr("|.", word[0])) /* "|", "..." */
        fprintf(f, "\\&%.*s\n", (int)n, word);
    else if (n > 2 && !memcmp(word, "--", 2))
        fprintf(f, ".Fl \\-%.*s\n", (int)n - 2, word + 2);
    else if (n > 1 && word[0] == '-')
        fprintf(f, ".Fl %.*s\n", (int)n - 1, word + 1);
    else if (opens && closes)
        fprintf(f, ".Op Ar %.*s\n", (int)n - 2, word + 1);
    else if (opens) {
        fprintf(f, ".No \\&%c\n", word[0]);
        options_help_mdoc_word(f, word + 1, n - 1);
    } else if (closes)
        fprintf(f, ".Ar %.*s %c\n", (int)n - 1, word, word[n - 1]);
    else
        fprintf(f, ".Ar %.*s\n", (int)n, word);
}

static void options_help_mdoc_usage(FILE *f, const struct options_spec *spec)
{
    fprintf(f, ".Sh SYNOPSIS\n");
    for (const char *p = spec->usage; *p;) {
        p += strspn(p, " \n");
        size_t line = strcspn(p, "\n"), at = 0;
        fprintf(f, ".Nm citysplat %s\n", spec->command);
        for (size_t word = 0; at < line; word++) {
            size_t n = strcspn(p + at, " \n");
            if (word > 1) /* after "citysplat train" */
                options_help_mdoc_word(f, p + at, n);
            at += n;
            at += strspn(p + at, " ");
        }
        p += line;
    }
}

static void options_help_mdoc_one(FILE *f, const struct options_def *d)
{
    char flag[OPTIONS_NAME_MAX + 4];
    options_help_shown_flag(d, flag);
    const char *value = options_help_value(d);
    fprintf(f, ".It Fl \\-%s%s%s\n", flag, *value ? " Ar " : "", value);
    if (options_help_is_on(d))
        fprintf(f, "Turn off:\n");
    options_help_mdoc_text(f, d->help);
    if (d->type != OPTIONS_BOOL && *d->def)
        fprintf(f, ".Pq default: %s\n", d->def);
}

static void options_help_mdoc_options(FILE *f, const struct options_spec *spec)
{
    bool open = false;
    fprintf(f, ".Sh OPTIONS\n");
    for (size_t i = 0; i < spec->n_defs; i++) {
        if (spec->defs[i].type == OPTIONS_GROUP) {
            fprintf(f, "%s.Ss %c%s\n.Bl -tag -width Ds\n", open ? ".El\n" : "",
                    toupper((unsigned char)spec->defs[i].help[0]), spec->defs[i].help + 1);
            open = true;
        } else {
            fputs(open ? "" : ".Bl -tag -width Ds\n", f);
            open = true;
            options_help_mdoc_one(f, &spec->defs[i]);
        }
    }
    fprintf(f, "%s.Ss Of every command\n.Bl -tag -width Ds\n", open ? ".El\n" : "");
    for (size_t i = 0; i < OPTIONS_HELP_ALWAYS; i++) {
        const struct options_help_always *a = &options_help_always[i];
        if (!strcmp(a->flag, "-h, --help"))
            fprintf(f, ".It Fl h , Fl \\-help\nPrint a text like this page.\n");
        else if (a->flag[1] == '-')
            fprintf(f, ".It Fl \\-%s%s%s\n%s\n", a->flag + 2, *a->value ? " Ar " : "", a->value,
                    a->about);
        else
            fprintf(f, ".It Fl %s\n%s\n", a->flag + 1, a->about);
    }
    fprintf(f, ".El\n");
}

static void options_help_mdoc(FILE *f, const struct options_spec *spec)
{
    options_help_mdoc_usage(f, spec);
    fprintf(f, ".Sh DESCRIPTION\n");
    options_help_mdoc_text(f, spec->about);
    options_help_mdoc_options(f, spec);
    fprintf(f, ".Sh EXIT STATUS\n0 done, 1 failed, 2 the command line was wrong.\n");
    if (spec->example) {
        fprintf(f, ".Sh EXAMPLES\n.Bd -literal -offset indent\n");
        options_help_mdoc_chars(f, spec->example, strlen(spec->example));
        fprintf(f, "\n.Ed\n");
    }
    fprintf(f, ".Sh SEE ALSO\n.Xr citysplat 1\n");
}

void options_help_print(FILE *f, const struct options_spec *spec, enum options_format format)
{
    if (format == OPTIONS_FORMAT_MARKDOWN)
        options_help_markdown(f, spec);
    else if (format == OPTIONS_FORMAT_MDOC)
        options_help_mdoc(f, spec);
    else
        options_help_text(f, spec, format == OPTIONS_FORMAT_ALL);
}
